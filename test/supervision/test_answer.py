# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A spool that does not answer the voltage: dead LVDT with noise, stuck spool, supply off."""

import math

import numpy as np
import pytest
from grids import grid

from research.campaigns import dirty
from valve_control.control.parameters import build
from valve_control.control.plant import valve
from valve_control.control.supervision import answer, lvdt
from valve_control.control.supervision.record import Mode
from valve_control.control.supervision.supervisor import Supervisor

FEEDBACK = ("arc", "oarc", "dcarc", "pid", *dirty.TUNED)
STANDING = 0.3  # s
BEYOND = 5.25  # V  lvdt.disturbance times the largest static gain, and a twentieth until it is told


@grid(
    "fault, law, noise, when",
    ["dead at -10 V", "dead at -9 V", "dead at 0 V", "flipped"],
    FEEDBACK,
    dirty.NOISES,
    dirty.WHEN,
)
def test_a_wrong_reading_with_noise_moves_the_spool_no_further_than_the_bound(fault, law, noise, when):
    found = dirty.outcome(dirty.run(law, dirty.FAULTS[fault], noise, when, 12))
    assert found.reaction < 0.3 and found.standing < 0.1 and found.beyond < 4.0


@grid("fault, law, noise, when", ["dead where it is", "flat"], FEEDBACK, dirty.NOISES, dirty.WHEN)
def test_a_dead_reading_that_nobody_can_tell_yet_moves_it_by_the_disturbance(fault, law, noise, when):
    """At rest on its command a dead reading asks for nothing: a law winds up as slowly as it likes."""
    found = dirty.outcome(dirty.run(law, dirty.FAULTS[fault], noise, when, 12))
    assert found.beyond < BEYOND
    assert when == "rest" or (found.standing < STANDING and found.reaction < 0.3)


@grid("fault, law, noise", ["stuck", "supply off"], FEEDBACK, dirty.NOISES)
def test_a_spool_without_force_gets_no_voltage_but_short_trials(fault, law, noise):
    samples = dirty.run(law, dirty.FAULTS[fault], noise, "start", 12)
    voltages, said, theta, held = [], "", None, None
    for _, voltage, _, supervisor in samples:
        theta = theta or supervisor.theta
        voltages.append(voltage)
        said += "" if supervisor.reason in said else supervisor.reason
        held = supervisor.theta if supervisor.mode is Mode.SAFE else held
    assert "the spool does not follow it: supply off, stuck spool or dead LVDT" in said
    assert "wrong sign" not in said
    assert np.mean(np.abs(voltages[500:])) < 1.0
    if theta is not None and len(theta) == 4:  # a1, a0, b0 and b0·dn
        assert held == pytest.approx(theta, rel=0.05, abs=1.5 * theta[2])  # b0 times a pull that agrees


@grid("law, bits, when", dirty.TUNED, dirty.BITS, ["rest", "motion"], strength=1)
@pytest.mark.parametrize("command", [1.0, 5.0])
def test_tuned_gains_stay_in_control(law, bits, when, command):
    *_, last = dirty.run(law, dirty.FAULTS["none"], "1", when, bits, wanted=command)
    assert last[3].counts["safe_stops"] == 0 and last[3].mode is not Mode.SAFE


@pytest.mark.parametrize(
    ("friction", "fault", "law", "wanted", "sticks"),
    [
        (1.16, "none", "d3fxe_pid", 1.0, False),
        (1.16, "none", "open_loop", 2.0, False),
        (4.64, "none", "d3fxe_pid", 1.0, True),
        (4.64, "none", "pid", 1.0, True),
        (1.16, "stuck", "open_loop", 2.0, True),
        (1.16, "stuck", "compensator", 2.0, True),
    ],
)
def test_a_spool_that_rests_away_from_command_or_voltage_is_told(friction, fault, law, wanted, sticks):
    """Hunting against the friction of cold oil, and a law without feedback that never gives much voltage."""
    changes = {"friction.coulomb": friction}
    said = set()
    for *_, supervisor in dirty.run(law, dirty.FAULTS[fault], "1", "start", 12, changes, wanted):
        said |= set(supervisor.conditions)
    assert ("spool_sticks" in said) == sticks and supervisor.counts["safe_stops"] == 0


def judged(readings, voltage):
    """What is said first of ``readings`` [V] under ``voltage`` [V], and after how many."""
    p, s = lvdt.Params(11.0, 500.0, 0.1, 20, 0.5, 0.001, 20.0, 1200.0, 1200.0, 5.0), answer.NOTHING
    for k, reading in enumerate(readings):
        wrong, s = answer.step(p, s, reading, 0.0, voltage, 1, False)
        if wrong:
            return k, wrong
    return None


def test_the_due_motion_is_that_of_the_laziest_valve():
    """10 V less 5 V of friction move 0.3 V within 12 ms, 5 ms after the filter; 5 V move nothing."""
    k, wrong = judged(np.zeros(100), 10.0)
    assert wrong == "unanswered" and 10 <= k <= 20
    assert judged(np.zeros(3000), 5.0) is None
    assert judged(-0.5 * 1200.0 * 5.0 * (0.001 * np.arange(100)) ** 2, 10.0)[1] == "wrong_sign"
    assert judged(0.5 * 1200.0 * 5.0 * (0.001 * np.arange(60)) ** 2, 10.0) is None


def back(law, hardware):
    """Voltages [V] of a 5 V sine at 0.5 Hz; from 2.3 to 4.3 s ``hardware`` is gone, or the supply is off."""
    values, plant = dirty.setting(law)
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    p, random = build.valve_params(plant), np.random.default_rng(1)
    s, voltages, said = valve.initial(p), [], ""
    for k in range(6500):
        gone = 2300 <= k < 4300
        supervisor.command(5.0 * math.sin(2.0 * math.pi * 0.5 * k * dirty.PERIOD))
        reading = valve.read(p, s, float(random.standard_normal()))
        if gone and hardware:
            voltages.append(supervisor.silence(dirty.PERIOD))
        else:
            voltages.append(supervisor.sample(reading, k + 1, 0.0 if k == 4300 else dirty.PERIOD))
        s = s if gone and not hardware else valve.step(p, s, voltages[-1])
        said += supervisor.reason if k >= 4300 and supervisor.reason not in said else ""
    assert supervisor.mode is not Mode.SAFE
    return np.array(voltages), said


@grid("law, hardware", FEEDBACK, [True, False])
def test_hardware_or_supply_that_returns_in_motion_makes_no_kick(law, hardware):
    voltages, said = back(law, hardware)
    usual = np.max(np.abs(np.diff(voltages[500:2300])))
    first = 4300 + np.flatnonzero(voltages[4300:] == 0.0)[0] if not hardware else 4300
    first += np.flatnonzero(voltages[first:] != 0.0)[0]
    assert np.max(np.abs(np.diff(voltages[first - 1 : first + 5]))) <= 1.5 * usual
    assert "wrong sign" not in said
