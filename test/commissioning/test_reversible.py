# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Whatever ends a commissioning: 0 V, parameters as before, no voltage beyond the limit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from supervised import Steps, SupervisedValve

from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve as plant
from valve_control.design.commissioning import sequence
from valve_control.design.commissioning.bench import (
    Diagnosis,
    Fault,
    Pause,
    Plan,
    SafetyLimits,
    Swings,
    Watch,
    check,
)
from valve_control.parameter import ParameterError, defaults, updated

LIMITS = SafetyLimits(3.0, 1.5)
BEFORE = {"controller": "oarc", "u_max": 9.0, "oarc.k1": 77.0, "command_limit": 8.0, "reshaping.lead": 0.004}
PLAN = Plan(LIMITS, "pid", 0.3, 40, 3, 8, 1, 2)


@settings(max_examples=8)
@given(st.integers(1, 30_000), st.booleans())
def test_a_fault_at_any_sample(at, interrupt):
    """In the tests of the valve, which take some 35,000 samples with these limits."""
    valve = SupervisedValve({"friction.coulomb": 0.6, "lvdt.noise": 0.004}, BEFORE, fault_at=at)
    valve.fault = KeyboardInterrupt if interrupt else Fault
    before, reversal = valve.values(), sequence.Reversal()
    with pytest.raises(valve.fault), sequence.reversible(valve, before, reversal):
        sequence.Commissioning(valve, PLAN, before, Steps()).run()
    assert len(valve.readings) == at
    assert valve.active and valve.values() == before
    assert reversal.restored and len(reversal.report) == 3
    assert np.max(np.abs(valve.voltages)) <= LIMITS.voltage
    assert valve.applied[0]["u_max"] == LIMITS.voltage
    assert at < 600 or valve.applied[1] == {"lvdt.limit": LIMITS.travel}


@pytest.mark.parametrize("answers", [0, 1, 2])
def test_a_step_that_is_refused(answers):
    valve = SupervisedValve({"lvdt.noise": 0.004}, BEFORE)
    before, steps = valve.values(), Steps([True] * answers)
    with pytest.raises(sequence.Refused), sequence.reversible(valve, before, sequence.Reversal()):
        sequence.Commissioning(valve, PLAN, before, steps).run()
    assert valve.values() == before and valve.active


def test_a_controller_that_was_inactive_stays_so():
    valve = SupervisedValve({"lvdt.noise": 0.004}, BEFORE, fault_at=900)
    valve.off()
    with pytest.raises(Fault), sequence.reversible(valve, valve.values(), sequence.Reversal()):
        sequence.Commissioning(valve, PLAN, valve.values(), Steps()).run()
    assert not valve.active


@pytest.mark.campaign
def test_from_first_to_last_step():
    """dcarc on a valve with friction: afterwards its gains differ, and they do what was said."""
    valve = SupervisedValve({"friction.coulomb": 0.6, "lvdt.noise": 0.004}, BEFORE)
    before, steps = valve.values(), Steps()
    with sequence.reversible(valve, before, sequence.Reversal()):
        found = sequence.Commissioning(valve, PLAN._replace(law="dcarc"), before, steps).run()
    for name in ("slow triangle", "stepped sine", "model", "tuning"):
        shares = np.array([done / total for step, done, total in steps.reports if step == name])
        assert shares[0] <= 0.01 and shares[-1] == 1.0 and np.all(np.diff(shares) >= 0.0), name
    assert found.tuned.chatter == PLAN.chatter  # no quieter search, since the run is not LOUD
    assert len(steps.asked) == 6 + 2 * len(steps.refusals) and valve.active  # a second search asks twice
    assert valve.values() == {**before, **found.applied}
    assert found.applied["controller"] == "dcarc" and "u_max" not in found.applied
    assert {name.split(".")[0] for name in found.applied} <= {"controller", "dcarc", "arc", "reshaping"}
    assert np.max(np.abs(valve.voltages)) <= LIMITS.voltage
    assert np.max(np.abs(valve.readings)) <= LIMITS.travel
    assert found.verification.measured.e_rms < 2.0 * found.verification.expected.e_rms + 0.002
    assert found.tests.plant.friction.coulomb == pytest.approx(0.6, abs=0.03)
    sequence.restore(valve, before)
    assert valve.values() == before


class BecomesLater(Steps):
    """When the model is found, the dead time of ``valve`` grows to ``delay`` [s]."""

    def __init__(self, valve, delay):
        super().__init__()
        self._valve, self._delay = valve, delay

    def fitted(self, valve):
        super().fitted(valve)
        bench = self._valve
        bench.plant = updated(VALVE, bench.plant, {"lvdt.delay": self._delay})
        bench.params = build.valve_params(bench.plant)
        bench.state = plant.initial(bench.params)


def commissioned_later(delay):
    """A valve whose dead time grows from 0.5 ms to ``delay`` [s], and how its commissioning ends."""
    valve = SupervisedValve({"friction.coulomb": 0.6, "lvdt.noise": 0.004, "lvdt.delay": 0.0005})
    before, steps = valve.values(), BecomesLater(valve, delay)
    wanted = PLAN._replace(law="dcarc", chatter=0.4, budget=60, valves=4)
    with sequence.reversible(valve, before, sequence.Reversal()):
        result = sequence.Commissioning(valve, wanted, before, steps).run()
    return valve, before, steps, result


@pytest.mark.campaign
def test_gains_that_the_running_valve_does_not_take_are_sought_once_more():
    """The dead time grows by five periods: a swing, 0 V, and gains for a box twice as wide hold."""
    valve, before, steps, found = commissioned_later(0.0055)
    (changes, reason), *more = steps.refusals
    assert not more and ("voltage oscillates at" in reason or "not that of the model" in reason)
    assert valve.values() == {**before, **found.applied} and valve.active
    assert found.applied["dcarc.voltage_weight"] != changes["dcarc.voltage_weight"]
    assert any("gains were not accepted" in note and reason in note for note in found.notes)
    assert found.verification.measured.e_rms < 2.0 * found.verification.expected.e_rms + 0.002
    assert steps.valve["friction.coulomb"] == pytest.approx(0.6, abs=0.03)
    assert np.max(np.abs(valve.voltages)) <= LIMITS.voltage
    asked = [text for text in steps.asked if "sets of gains" in text]
    assert len(asked) == 2 and reason in asked[1] and "for a box 2 times as wide" in asked[1]


@pytest.mark.parametrize(
    ("limits", "law", "words"),
    [
        (SafetyLimits(12.0, 1.0), "pid", "--max-voltage is 12 V; it must lie between 0.1 V and u_max, 9 V"),
        (SafetyLimits(3.0, 9.0), "pid", "--travel is 9 V; it must lie between 0.2 V and"),
        (SafetyLimits(3.0, 1.0), "open_loop", "open_loop has no gains to choose"),
    ],
)
def test_plans_that_do_not_fit_are_refused_before_anything_happens(limits, law, words):
    values = updated(CONTROLLER, defaults(CONTROLLER), BEFORE)
    with pytest.raises(ParameterError, match=words):
        check(PLAN._replace(limits=limits, law=law), values)


def test_the_watch_ends_it_at_the_first_wrong_message():
    watch = Watch(LIMITS)
    watch.voltage(3.0)
    for wrong in (3.0001, -3.0001, float("nan")):
        with pytest.raises(Fault, match="beyond the limit"):
            watch.voltage(wrong)
    watch.reading(1.6)
    watch.reading(1.6)
    watch.reading(1.4)  # two may be noise
    watch.reading(-1.6)
    watch.reading(-1.6)
    with pytest.raises(Fault, match="beyond the travel"):
        watch.reading(-1.6)
    watch = Watch(LIMITS._replace(travel=np.inf))
    watch.reading(np.nan)
    watch.reading(np.nan)
    with pytest.raises(Pause, match="not finite"):  # a driver has lost readings
        watch.reading(np.nan)
    usual = Diagnosis(
        False, True, frozenset(), "words that nobody reads: oscillates, saturated for, inactive"
    )
    watch.diagnosis(usual._replace(conditions=frozenset({"lvdt_bridged"})))
    for conditions, safe, kind in (
        ({"oscillation"}, False, Swings),
        ({"lvdt_silent"}, True, Pause),
        ({"stalled", "lvdt_jump"}, True, Pause),
        ({"lvdt_not_finite"}, True, Pause),
        ({"lvdt_jump"}, True, Fault),
        # What must not go on with other gains is no mere swing, nor a pause.
        ({"oscillation", "lvdt_jump"}, True, Fault),
        ({"oscillation", "command_publishers"}, False, Fault),
        ({"lvdt_silent", "voltage_publishers"}, True, Fault),
        ({"saturation"}, False, Fault),
    ):
        with pytest.raises(Fault) as ended:
            watch.diagnosis(usual._replace(conditions=frozenset(conditions), safe=safe))
        assert ended.type is kind
    with pytest.raises(Fault) as ended:
        watch.diagnosis(usual._replace(active=False))
    assert ended.type is Fault
