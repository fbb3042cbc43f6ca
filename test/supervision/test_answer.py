# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A spool that does not answer the voltage: dead LVDT with noise, stuck spool, supply off."""

import shutil

import numpy as np
import pytest
from grids import grid

from research.campaigns import dirty
from valve_control.control.supervision import answer, lvdt
from valve_control.control.supervision.memory import Mode

FEEDBACK = ("arc", "oarc", "dcarc", "pid", *dirty.TUNED)
SOME = ("oarc", "d3fxe_experiment_dcarc")  # in each run of the tests, the others in the campaign
STANDING = 0.3  # s
DISTURBANCE = 5.5  # V  g·D·‖h‖ of docs/explanation/plausibility.md with ‖h‖ of the D3FXE's damping
BOUNDS = {  # V  of the true spool beyond the command
    **dict.fromkeys(("dead at -10 V", "dead at -9 V", "dead at 0 V", "flipped"), 4.0),
    **dict.fromkeys(("dead where it is", "flat"), DISTURBANCE),
}


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize(
    "law", [law if law in SOME else pytest.param(law, marks=pytest.mark.campaign) for law in FEEDBACK]
)
def test_no_reading_moves_the_spool_further_than_its_bound(law):
    """Each noise and converter, from the start, at rest and in motion, in the exported C.

    At rest on its command a dead reading asks for nothing: a law winds up as slowly as it likes.
    """
    for fault, bound in BOUNDS.items():
        for case in dirty.faulty(law, fault, True):
            given = dirty.signals(case)
            row = dirty.outcome(case, given, dirty.run(case, given))
            assert row.beyond < bound, (case, row)
            if case.motion != "rest" or bound < DISTURBANCE:
                assert row.reaction < STANDING and row.standing < STANDING, (case, row)
    assert dirty.repeated(case)[0]


@grid("fault, law, noise", ["stuck", "supply off"], FEEDBACK, dirty.NOISES)
def test_a_spool_without_force_gets_no_voltage_but_short_trials(fault, law, noise):
    case = dirty.Case(law, fault, noise, "start")
    voltages, reasons, theta, held = [], "", None, None
    for _, voltage, supervisor in dirty.samples(case, dirty.signals(case)):
        theta = theta or supervisor.theta
        voltages.append(voltage)
        reasons += "" if supervisor.reason in reasons else supervisor.reason
        held = supervisor.theta if supervisor.mode is Mode.SAFE else held
    assert "the spool does not follow it: supply off, stuck spool or dead LVDT" in reasons
    assert noise == "10" or "wrong sign" not in reasons  # docs/howto/faults.md
    assert np.mean(np.abs(voltages[500:])) < 1.0
    if theta is not None and len(theta) == 4:  # a1, a0, b0 and b0·dn
        assert held == pytest.approx(theta, rel=0.05, abs=1.5 * theta[2])  # b0 times a pull that agrees


def judged(readings, voltage, b0=1200.0):
    """What is said first of ``readings`` [V] under ``voltage`` [V], and after how many."""
    p, s = lvdt.Params(11.0, 500.0, 0.1, 20, 0.5, 0.001, 20.0, 1200.0, b0, 5.0), answer.NOTHING
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
    assert judged(np.zeros(100), 10.0, 0.0) is None  # no model
    assert judged(np.full(100, 10.0), 30.0) is None  # at the end of its stroke
    assert judged(-0.5 * 1200.0 * 5.0 * (0.001 * np.arange(100)) ** 2, 10.0)[1] == "wrong_sign"
    assert judged(0.5 * 1200.0 * 5.0 * (0.001 * np.arange(60)) ** 2, 10.0) is None
