# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""LVDTs of wrong sign, gain or slope around a simulated valve: found from motion, held off, said in words."""

import math

import numpy as np
import pytest
import sizes
from grids import grid
from test_supervisor import LAWS, PERIOD, Loop

from valve_control.control.compiling import compile_function
from valve_control.control.laws import registry
from valve_control.control.parameters import build, files, ros_file
from valve_control.control.parameters.table import NODES, VALVE
from valve_control.control.plant import valve
from valve_control.control.simulation import batch, robustness
from valve_control.control.supervision import answer, lvdt, lvdt_trust, plausibility
from valve_control.control.supervision.memory import Mode
from valve_control.parameter import defaults, updated

FEEDBACK = tuple(name for name, law in registry.LAWS.items() if law.feedback)
D3FXE = files.load(str(ros_file.config_folder() / "d3fxe.yaml"))["valve_simulator"]


def flipped(reading):
    return -reading


def moving(law, amplitude=2.0, frequency=1.5, plant=None, **changes):
    loop = Loop(law, **changes)
    if plant:
        loop.p = build.valve_params(updated(VALVE, defaults(VALVE), plant))
        loop.s = valve.initial(loop.p)
    loop.command = lambda: amplitude * math.sin(2.0 * math.pi * frequency * loop.k * PERIOD)
    return loop


def until_safe(loop, spoil, limit):
    """Samples until the voltage is off; what was said then."""
    for n in range(limit):
        loop.step(spoil)
        if loop.supervisor.mode is Mode.SAFE:
            return n, loop.supervisor.reason
    return limit, ""


def believed(loop):
    return not any(name.startswith("lvdt") for name in loop.supervisor.conditions)


def words(loop, spoil, n):
    """All that is said in ``n`` samples, and the largest voltage after the first time it was off."""
    said, largest, off = [], 0.0, False
    for _ in range(n):
        loop.step(spoil)
        off = off or loop.supervisor.mode is Mode.SAFE
        largest = max(largest, abs(loop.supervisor.voltage) if off else 0.0)
        if loop.supervisor.reason not in said:
            said.append(loop.supervisor.reason)
    return "; ".join(said), largest


@grid(
    "law, motion",
    FEEDBACK,
    [(2.0, None, 0), (0.3, None, 1011), (0.3, D3FXE, 1420), (2.0, None, 1180), (2.0, D3FXE, 1011)],
    strength=1,
)
def test_flipped_sign_is_switched_off_within_a_tenth_of_a_second_and_held_off(law, motion):
    amplitude, plant, moment = motion
    loop = moving(law, amplitude, plant=plant).run(moment)
    n, _ = until_safe(loop, flipped, 1000)
    assert n <= 150
    before = loop.supervisor.memory.counts["safe_stops"]
    said, largest = words(loop, flipped, 4000)
    assert "LVDT readings disagree with the voltage: wrong sign" in said
    assert largest <= 6.0  # never again to the limit
    on = sum(abs(v) > 0.0 for v in loop.voltages[-4000:])
    assert on < 1000 and loop.supervisor.memory.counts["safe_stops"] - before <= 4  # less and less often
    loop.run(6000)
    assert believed(loop)


@pytest.mark.parametrize("law", ["compensator", "open_loop"])
@pytest.mark.parametrize(("amplitude", "limit"), [(0.3, 2.0), (2.0, 1.0)])
def test_flipped_sign_is_found_without_feedback_too(law, amplitude, limit):
    loop = moving(law, amplitude).run(1011)
    said, _ = words(loop, flipped, int(limit / PERIOD))
    assert "wrong sign" in said


@grid("law, gain", LAWS, [0.5, 2.0], strength=1)
def test_a_gain_that_leaps_in_motion_is_not_believed_again(law, gain):
    def spoil(reading):
        return gain * reading

    loop = moving(law, 1.5).run(1180)
    n, reason = until_safe(loop, spoil, 100)
    assert n == 20 and "jump" in reason
    said, largest = words(loop, spoil, 4000)
    assert f"LVDT readings disagree with the voltage: gain about {gain:g}" in said
    assert largest <= 6.0
    loop.run(7000)
    assert believed(loop)


def test_reset_ends_the_doubt_and_the_readings_have_to_prove_it():
    loop = moving("arc").run(1180)
    words(loop, flipped, 2500)
    assert loop.supervisor.mode is Mode.SAFE
    loop.supervisor.reset()
    loop.run(60)
    assert believed(loop)
    n, _ = until_safe(loop, flipped, 1000)
    assert n <= 150


@grid(
    "law, plant, motion",
    LAWS,
    [D3FXE, {**D3FXE, "friction.coulomb": 2.0, "friction.static_ratio": 2.0}],
    [(0.3, 1.5), (2.0, 1.5), (2.9, 6.0), (1.0, 15.0)],  # V, Hz
)
def test_sound_readings_are_never_doubted(law, plant, motion):
    loop = moving(law, *motion, plant).run(2500)
    assert loop.supervisor.memory.counts["safe_stops"] == loop.supervisor.memory.counts["lvdt_refused"] == 0


def test_slope_is_that_of_the_voltage_without_its_friction():
    p = plausibility.design((20.0, 1200.0, 1200.0), 0.001, 1.0, 0.1)
    sums = plausibility.NOTHING
    for k in range(300):
        w, s = math.sin(0.1 * k), math.copysign(1.0, math.cos(0.1 * k))
        sums = plausibility.add(1.0, sums, 1.3 * w + 0.8 * s + 0.4, w, w, s)
    assert plausibility.slope(p, sums) == pytest.approx(1.3, rel=1e-9)
    little = plausibility.add(1.0, plausibility.NOTHING, 0.1, 0.1, 0.1, 1.0)
    assert plausibility.slope(p, little) == 0.0
    shown = plausibility.initial(p, 0.0, 0.0).shown._replace(moved=plausibility.AGREED, sums=little)
    assert plausibility.ratio(p, shown, plausibility.Doubt(1.0, 0.0, 1.0)) == 0.0


@pytest.mark.parametrize("friction", [0.0, 1.16, 3.0])
@pytest.mark.parametrize("after", [0.2, 0.5, 0.8, 1.2, 2.0 * math.pi])
@pytest.mark.parametrize("amplitude", [0.3, 1.0])
def test_friction_over_part_of_a_cycle_turns_no_sign_round(friction, after, amplitude):
    """u = w + F·sgn w' from 1.2 rad before the turn of a sine to ``after`` [rad] behind it, as z and as w."""
    p = plausibility.design((20.0, 1200.0, 1200.0), 0.001, 1.0, 0.1)
    sound = wrong = plausibility.NOTHING
    for angle in 0.5 * math.pi + np.linspace(-1.2, after, 100):
        w, s = amplitude * math.sin(angle), math.copysign(1.0, math.cos(angle))
        u = w + friction * s
        sound = plausibility.add(p.keep, sound, u, w, w, s)
        wrong = plausibility.add(p.keep, wrong, u, -w, -w, -s)
    assert plausibility.wrongness(p, sound) <= 0.0
    if after > 2.0 and friction <= 4.0 * amplitude:
        assert plausibility.wrongness(p, wrong) > 0.0


@pytest.mark.parametrize(("leap", "text"), [(-0.3, ", or are late by 10 ms"), (0.3, ""), (-3.0, "")])
def test_readings_that_jump_back_along_their_course_may_be_late(leap, text):
    """At 30 V/s 10 ms are 0.3 V; 3 V would be 100 ms."""
    p, s = lvdt.Params(11.0, 500.0, 0.1, 0, 0.5, 0.001, 0.0, 0.0, 0.0, 0.0), lvdt.NOTHING
    for k in range(220):
        fault, s = lvdt.step(p, s, 0.03 * k + (leap if k >= 200 else 0.0), 0, 0.0, False, 0.001)
        assert (fault == "lvdt_jump") == (k >= 200)
    assert lvdt.lateness(s) == text


def first_alarm(p, judge, readings, voltages):
    """Number of the reading after which the watch finds the LVDT wrong, 0: never."""
    s, a = plausibility.initial(p, readings[0], 0.0, 0.0), answer.NOTHING
    for k in range(1, len(readings)):
        s = plausibility.step(p, s, readings[k], voltages[k - 1], 1.0)
        speed = (readings[k - 1] - readings[max(0, k - 4)]) / (3.0 * judge.period)
        wrong, a = answer.step(judge, a, readings[k], speed, voltages[k - 1], 1, False)
        if s.shown.wrong_sign > 0.0 or wrong != "":
            return k
    return 0


def recordings(law, scenario, first, count):
    """Watch, readings and voltages [V] of the valves of the study's box from number ``first`` on."""
    settings = {node: defaults(table) for node, table in NODES.items()}
    settings["controller"] = updated(NODES["controller"], settings["controller"], {"controller": law})
    source = updated(NODES["command_source"], settings["command_source"], {"scenario": scenario})
    chosen = robustness.Study({**settings, "command_source": source}, count, 1)
    points, periods = robustness.draw(chosen, first, count)
    for period in np.unique(periods):
        numbers = np.flatnonzero(periods == period)
        valves = [robustness.valve_of(chosen, first + int(i), points[i], float(period)) for i in numbers]
        controller = robustness.sampled(chosen, "controller", float(period))
        command = build.commands(robustness.sampled(chosen, "command_source", float(period)))
        params = build.law_params(controller)
        rows = batch.records([build.valve_params(values) for values in valves])
        traces = np.empty((len(valves), len(command), 3))
        batch.simulate(batch.Batch(law, params, rows, 1 + first + numbers, command), 1, traces)
        for _, readings, voltages in np.moveaxis(traces, 2, 1):
            watch = lvdt_trust.design(controller, params)
            yield watch.comparison, watch.judge, readings, voltages


@grid("law, scenario", registry.LAWS, ["point_to_point", "sine"], strength=1)
@pytest.mark.parametrize("count", [256, pytest.param(sizes.VALVES, marks=pytest.mark.campaign)])
def test_no_valve_of_the_study_s_box_is_taken_for_a_wrong_lvdt(law, scenario, count):
    """Gains, speeds, friction, flow forces, drift, noise, delays and periods; unstable loops too."""
    watch = compile_function(first_alarm)
    found = 0
    for first in range(0, count, 250):
        for p, judge, readings, voltages in recordings(law, scenario, first, min(250, count - first)):
            assert watch(p, judge, readings, voltages) == 0
            found += watch(p, judge, -readings, voltages) > 0
    least = count if law in FEEDBACK else 0.8 * count  # without feedback some valves stick
    if law == "dcarc":  # misses one sound loop of 256 (sine, 0.5 ms)
        least = 0.99 * count
    assert found >= least
