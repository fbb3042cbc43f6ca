# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gains from before beside new ones, quieter gains beside loud ones, and what counts of a verifying run."""

from types import SimpleNamespace

import numpy as np
import pytest
from supervised import Steps, SupervisedValve

from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.commissioning import gains, sequence, valve_fit
from valve_control.design.commissioning.bench import Plan, Record, SafetyLimits, Swings
from valve_control.design.commissioning.evaluation import Friction, Rest
from valve_control.design.tuning.trial import TuningMotion
from valve_control.parameter import defaults, updated

LIMITS = SafetyLimits(4.0, 2.0)
PLAN = Plan(LIMITS, "dcarc", 0.25, 20, 4, 4, 1, 1)
PERIOD = 0.001
# Of a solenoid valve that was taken for a linear one; the gains of the paper swing at 76 Hz with 4 V there.
VALVE_OF_IT = TransferFunction((4230.37,), (1.0, 95.0777, 5372.25))
LATE = valve_fit.Plant(VALVE_OF_IT, Friction(0.94, 1.12), -0.26, 0.00332, 11.0)
TESTS = sequence.Tests(None, None, None, None, None, None)
WANTED = 0.5 * np.sin(np.arange(2000) * 0.02)


def test_a_kick_after_a_late_voltage_is_the_machine_and_any_other_the_gains():
    noise = np.random.default_rng(2).standard_normal(len(WANTED))
    quiet = Record(PERIOD, WANTED + 1e-3 * noise, WANTED, WANTED, late=np.arange(len(WANTED)) == 700)
    kicked = quiet.reading.copy()
    kicked[710:850] += 0.3
    usual = gains._indices(quiet)
    assert gains._indices(quiet._replace(reading=kicked)) == usual
    assert gains._indices(quiet._replace(reading=np.roll(kicked, 300))).e_rms > 20.0 * usual.e_rms
    whole = Record.joined([quiet.part(0, 600), quiet.part(600, len(WANTED))])
    assert np.array_equal(gains.steady(whole), gains.steady(quiet)) and np.mean(~gains.steady(quiet)) == 0.1
    assert "late messages reach 10% of the verification run" in gains.about_late(quiet)[0]


def judged(before, new, wanted=WANTED, **changes):
    """A verification run of ``new`` parameters that follows its motion, beside those from ``before``."""
    own = valve_fit.values(LATE, Rest(0.0, 0.0027, 0.0), PERIOD, LIMITS.voltage)
    valve = updated(VALVE, defaults(VALVE), own)
    made = gains.TunedGains(SimpleNamespace(chatter=0.25), [], valve, new)
    record = Record(PERIOD, wanted, wanted, wanted)
    values = updated(CONTROLLER, defaults(CONTROLLER), before)
    return gains.judged(PLAN, values, made, gains.VerifyingMotion(wanted, 0), record, **changes)


@pytest.mark.parametrize(("before", "stable"), [({}, False), ({"controller": "open_loop"}, True)])
def test_gains_that_swing_in_simulation_are_no_rival(before, stable):
    """Saturated, a run stays finite whatever the loop does."""
    found = judged(before, {"controller": "open_loop"})
    assert (found.former is not None) == stable and not found.reasons


def test_gains_from_before_that_are_better_in_simulation_win():
    """Unless the model is doubted. The new ones leave the spool to its friction."""
    before, new = ({"controller": "open_loop", "open_loop.static_gain": gain} for gain in (0.8, 4.0))
    far = 3.0 * WANTED
    found = judged(before, new, far)
    assert found.former.e_rms < found.expected.e_rms
    (reason,) = found.reasons
    assert "in simulation the previous parameters do better" in reason
    assert not judged(before, new, far, doubted=True).reasons and not judged(new, before, far).reasons


class Swinging(SupervisedValve):
    def drive(self, course, limits, elapsed):
        raise Swings("the controller says: voltage oscillates")


def test_a_run_of_verification_has_the_lead_that_stays():
    """Of a law that chooses none; the tests need commands without it."""
    valve = Swinging({}, {"reshaping.lead": 0.004, "command.lag": 0.002})
    before = valve.values()
    valve.apply(LIMITS.applied(before))
    assert valve.controller["reshaping.lead"] == 0.0
    still = [TuningMotion("none", np.zeros(10))]
    made = gains.TunedGains(SimpleNamespace(law="compensator"), still, {}, {"controller": "compensator"})
    run = sequence.Commissioning(valve, PLAN, before, Steps())
    assert run._verified(made, False)[1] == ["the controller says: voltage oscillates"]
    assert valve.controller["reshaping.lead"] == 0.004
    assert valve.controller["command_limit"] == LIMITS.travel and valve.controller["u_max"] == LIMITS.voltage
    assert valve.controller["command.lag"] == 0.0
    assert valve.controller["command.bridge"] == before["command.bridge"] > 0.0  # points may come late


@pytest.mark.parametrize(
    ("loud", "errors", "limits", "turn"),
    [
        ([0.5, 0.2], [0.01, 0.01], [0.25, 0.125], 2),
        ([0.5, 0.6], [0.01, 0.01], [0.25, 0.125], 1),
        ([0.5, 0.2], [0.01, 0.03], [0.25, 0.125], 2),
        ([0.5, 0.4], [0.01, 0.03], [0.25, 0.125], 1),
        ([0.3, 0.2], [0.01, 0.03], [0.25, 0.25**2 / 0.3], 1),
        ([0.5, 0.49], [0.01, 0.01], [0.25, 0.125], 2),
    ],
)
def test_a_loud_run_is_tuned_again_with_a_lower_limit(monkeypatch, loud, errors, limits, turn):
    """Quieter gains with a larger error count only where the run is 1.3 times as loud as allowed."""
    asked, simulated = [], iter(loud)

    def tuned(plan, *others):
        asked.append(plan.chatter)
        seen = SimpleNamespace(e_rms=np.array([[errors[len(asked) - 1]]]))
        good = SimpleNamespace(verified=SimpleNamespace(reasons=[], seen=seen))
        return gains.TunedGains(SimpleNamespace(chatter=0.25, chosen=good, turn=len(asked)), [], {}, {})

    monkeypatch.setattr(gains, "tuned", tuned)
    monkeypatch.setattr(gains, "loudness", lambda *about: next(simulated))
    run = sequence.Commissioning(SupervisedValve(), PLAN, defaults(CONTROLLER), Steps())
    made = run._searched(TESTS, None, 1.0)
    assert asked == pytest.approx(limits) and made.tuned.turn == turn
    told = f"from {loud[0]:.3g} to {loud[turn - 1]:.3g}"
    assert (told in made.note) == (turn > 1)


def test_the_approach_of_a_verification_run_is_not_judged():
    """Whatever is measured before the motions changes no figure and no reason."""
    swing = TuningMotion("sine", 0.3 * np.sin(np.arange(400) * 0.05))
    stroke = TuningMotion("strokes", 0.5 * np.sin(np.arange(600) * 0.02) ** 2)
    valve = updated(
        VALVE, defaults(VALVE), valve_fit.values(LATE, Rest(0.0, 0.0027, 0.0), PERIOD, LIMITS.voltage)
    )
    made = gains.TunedGains(
        SimpleNamespace(chatter=0.25), [stroke, swing], valve, {"controller": "open_loop"}
    )
    motion = gains.verifying_motion(made, PERIOD)
    rest, n = round(gains.HOME / PERIOD), motion.judged
    assert not np.any(motion.wanted[:rest])
    assert np.array_equal(motion.wanted[rest : rest + 400], swing.wanted)
    assert np.array_equal(motion.wanted[n : n + 600], stroke.wanted)
    values = defaults(CONTROLLER)
    away = np.where(np.arange(len(motion.wanted)) < n, 1.0, 0.0)
    found = []
    for off in (0.0, 0.5):
        record = Record(PERIOD, motion.wanted + off * away + 1e-3, motion.wanted + off * away, motion.wanted)
        part = gains.judged_part(motion, record, len(motion.wanted))
        one = gains.judged(PLAN, values, made, motion, part)
        found.append((one.measured, one.expected, one.reasons, len(one.record.reading)))
    assert found[0] == found[1] and found[0][-1] == len(motion.wanted) - n
