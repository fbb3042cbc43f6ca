# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A command or a point that is late: the motion goes on, and what comes joins without a kink."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as trials
from hypothesis import strategies as st
from slow import D3FXE, PERIOD, bare, moving, run, settings, sine

from research import late_commands as study
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision import late_commands
from valve_control.control.supervision.late_commands import Motion
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated

TIME = 0.006
EACH = late_commands.design(settings())
EVERY = late_commands.design(settings(command__interpolation="bridge"))
numbers = st.floats(-100.0, 100.0)


def test_a_bridge_is_built_from_the_parameters():
    assert late_commands.design(settings(command__bridge=0.0)) is None
    assert EACH.time == TIME and not EACH.every and EVERY.every


@given(numbers, numbers, numbers, st.floats(0.0, 0.02), st.floats(0.0, 0.02), st.floats(10.0, 500.0))
def test_a_distance_decays_as_a_third_order_system_does(x, v, a, first, second, rate):
    """In two steps as in one; and its derivatives are those of its course."""
    whole = late_commands.faded(Motion(x, v, a), rate, first + second)
    parts = late_commands.faded(late_commands.faded(Motion(x, v, a), rate, first), rate, second)
    assert parts == pytest.approx(whole, rel=1e-6, abs=1e-6)
    h = 1e-6
    before, after = (late_commands.faded(Motion(x, v, a), rate, first + d) for d in (-h, h))
    here = late_commands.faded(Motion(x, v, a), rate, first)
    size = 1.0 + max(abs(x) * rate**3, abs(v) * rate**2, abs(a) * rate)
    assert abs((after.position - before.position) / (2 * h) - here.velocity) < 1e-5 * size
    assert abs((after.velocity - before.velocity) / (2 * h) - here.acceleration) < 1e-5 * size


@given(st.lists(st.floats(0.004, 0.015), min_size=8, max_size=20), st.floats(0.0, 0.006))
def test_a_cubic_is_gone_on_with_exactly_however_unevenly_it_came(intervals, late):
    def cubic(t):
        return 0.1 + 3.0 * t - 20.0 * t**2 + 200.0 * t**3

    state, time = late_commands.begun(cubic(0.0), 0.0), 0.0
    for interval in intervals:
        time += interval
        state = late_commands.taken(EVERY, state, cubic(time), interval, time)
    course = late_commands.course(EVERY, state, time + late)
    assert course.position == pytest.approx(cubic(time + late), abs=2e-4)
    assert state.fit.motion.velocity == pytest.approx(3.0 - 40.0 * time + 600.0 * time**2, abs=0.1)


@trials(max_examples=6, deadline=None)
@given(st.lists(st.floats(-0.3, 0.3), min_size=30, max_size=60), st.sampled_from(["arc", "dcarc", "pid"]))
def test_commands_in_time_are_what_they_were_bit_for_bit(commands, law):
    voltages = []
    for time in (0.0, TIME):
        values = settings(controller=law, command__bridge=time, reshaping__lead=0.004)
        supervisor = Supervisor()
        supervisor.apply(values, build.law_params(values))
        made = []
        for k, command in enumerate(commands):
            supervisor.command(command)
            made.append(supervisor.sample(0.001 * (k % 3), k + 1 if k < 12 else k + 6))
        voltages.append(made)
    assert voltages[0] == voltages[1]


@pytest.mark.parametrize("every", [2, 5, 10])
def test_held_commands_of_a_slower_upper_level_are_in_time(every):
    runs = [run(bare(), every, samples=800, controller="arc", command__bridge=t) for t in (0.0, TIME)]
    assert np.array_equal(runs[0].voltage, runs[1].voltage)


def after_a_stop(send, samples=300, **changes):
    """Commands as the law gets them after an upper level in motion has stopped, and the last one sent."""
    values = settings(controller="open_loop", **changes)
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    got = []
    for k in range(40 + samples):
        if k < 40:
            send(supervisor, 30.0 * k * PERIOD)
        supervisor.sample(0.001 * (k % 3), k + 1)
        got.append(supervisor.telemetry()[2])
    return np.array(got[40:]), 30.0 * 39 * PERIOD


@pytest.mark.parametrize("kind", ["hold", "bridge"])
@pytest.mark.parametrize("trajectory", [False, True])
def test_after_an_upper_level_that_stopped_the_command_comes_to_rest_at_its_last(trajectory, kind):
    def send(supervisor, position):
        if trajectory:
            supervisor.trajectory(Motion(position, 30.0, 0.0), PERIOD)
        else:
            supervisor.command(position, PERIOD)

    got, last = after_a_stop(send, command__interpolation=kind)
    assert np.max(got) < last + 30.0 * 3.0 * TIME  # goes on for 6 ms, and brakes
    assert got[-1] == last
    assert np.max(np.abs(np.diff(got))) < 1.25 * 30.0 * PERIOD  # no faster than the motion was


def test_a_step_that_is_followed_by_a_pause_is_not_gone_beyond():
    for kind in ("hold", "bridge"):
        values = settings(controller="open_loop", command__interpolation=kind)
        supervisor = Supervisor()
        supervisor.apply(values, build.law_params(values))
        got = []
        for k in range(60):
            if k <= 20:
                supervisor.command(0.0 if k < 20 else 1.0, PERIOD)
            supervisor.sample(0.001 * (k % 3), k + 1)
            got.append(supervisor.telemetry()[2])
        assert got[19] == pytest.approx(0.0, abs=1e-9) and got[20] == 1.0  # it counts at once
        assert max(got) < 1.08 and min(got) > -1e-9


@trials(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(-10.0, 10.0), st.integers(0, 12)), min_size=5, max_size=40))
def test_the_command_stays_finite_and_within_its_limit(messages):
    for p in (EACH, EVERY):
        state, time = None, 0.0
        for command, pause in messages:
            state = late_commands.taken(p, state, command, (1 + pause) * PERIOD, time)
            for k in range(1 + pause):
                value = late_commands.value(p, state, time + k * PERIOD)
                assert math.isfinite(value) and abs(value) <= 10.0
            time += (1 + pause) * PERIOD


@pytest.mark.parametrize("law", ["dcarc", pytest.param("arc", marks=pytest.mark.campaign)])
@pytest.mark.parametrize(
    ("upper", "kind"),
    [
        (study.Upper(False, 1), "hold"),
        (study.Upper(True, 1), "hold"),
        (study.Upper(True, 10), "hold"),
        (study.Upper(False, 10), "bridge"),
        (study.Upper(True, 10), "bridge"),
    ],
)
def test_pauses_cost_little_under_tuned_gains(law, upper, kind):
    """Peak and c_u within 1.3 times those without pauses, the error within 1.5 times; unbridged 10 V."""
    without, unbridged, bridged = study.case("d3fxe", law, upper, kind)
    assert bridged.peak < 1.3 * without.peak and unbridged.peak > 9.99
    assert bridged.chatter < 1.3 * without.chatter
    assert bridged.error < 1.5 * without.error


def test_what_was_held_up_may_come_all_at_once():
    without = study.measured("d3fxe", "pid", study.Upper(False, 1), False)
    at_once = study.measured("d3fxe", "pid", study.Upper(False, 1, queued=True), True)
    assert at_once.peak < 1.3 * without.peak and at_once.chatter < 1.1 * without.chatter


def test_a_command_that_comes_a_sample_late_is_no_chatter():
    """By 0.7 ms: at 1 kHz two come for one sample and none for another."""
    even, held, bridged = (
        run(bare(), 1, controller="dcarc", jitter=jitter, command__bridge=time)
        for jitter, time in ((0.0, TIME), (0.0007, 0.0), (0.0007, TIME))
    )
    assert bridged.chatter < 1.3 * even.chatter < 0.7 * held.chatter


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.003])
def test_noise_on_the_commands_does_not_spoil_the_bridge(noise):
    """Chatter and error are below those where the last command holds."""
    found = []
    for time in (0.0, TIME):
        random = np.random.default_rng(2)

        def noisy(supervisor, time, interval, random=random):
            supervisor.command(sine(time) + noise * random.standard_normal(), 0.0)

        found.append(run(noisy, 1, samples=1500, jitter=0.0007, controller="dcarc", command__bridge=time))
    assert found[1].chatter < 0.75 * found[0].chatter and found[1].error < found[0].error


def test_trajectories_in_time_are_what_they_were_bit_for_bit():
    for every in (1, 10):
        runs = [run(moving(), every, samples=800, controller="arc", command__bridge=t) for t in (0.0, TIME)]
        assert np.array_equal(runs[0].voltage, runs[1].voltage)


def test_a_new_upper_level_on_the_way_to_neutral_joins_without_a_jump():
    """The one before has left at 2 V, and its successor begins with 3 V 40 ms later."""
    loop = Upper()
    for k in range(500):
        loop.go(2.0 * min(1.0, k / 300))
    loop.supervisor.command_gone()
    for _ in range(40):
        loop.go(None)
    for _ in range(60):
        loop.go(3.0)
    steps = np.abs(np.diff(loop.used[-70:]))
    assert steps.max() < 0.15


class Upper:
    """A supervisor on the simulated valve, and the command that its law gets."""

    def __init__(self):
        values = settings()
        self.supervisor = Supervisor()
        self.supervisor.apply(values, build.law_params(values))
        self.p = build.valve_params(updated(VALVE, defaults(VALVE), D3FXE))
        self.s = valve.initial(self.p)
        self.used, self.k = [], 0

    def go(self, command):
        """One sample, before it a ``command`` [V]; None: none."""
        if command is not None:
            self.supervisor.command(command)
        self.k += 1
        voltage = self.supervisor.sample(valve.read(self.p, self.s, 0.0), self.k)
        self.used.append(self.supervisor.memory.effective)
        self.s = valve.step(self.p, self.s, voltage)
