# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the tests show of valves with solenoids, and what the laws get to know of a valve that was found."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from supervised import Steps, SupervisedValve, fitted

from benchmarks import solenoid
from research import coil
from valve_control.control.laws import dcarc
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import linear_loop, margins
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.commissioning import gains, model, sequence, valve_fit
from valve_control.design.commissioning.bench import Plan, SafetyLimits
from valve_control.design.commissioning.evaluation import Friction, Rest
from valve_control.design.commissioning.valve_fit import Magnet
from valve_control.design.identification import first_gains
from valve_control.design.tuning import designs, limits, trial
from valve_control.parameter import defaults, updated

PERIOD = 0.001
REST = Rest(0.0, 0.003, 0.0049)
TRUE = Magnet(
    speed=58.0, damping=0.8, coil=0.004, gain=0.9, sides=0.1, hysteresis=0.2, overlap=0.05, coulomb=0.5,
    presliding=0.02, static_ratio=1.2, offset=0.1, delay=0.0012,
)  # fmt: skip
LIMITS = SafetyLimits(4.0, 2.0)


def plant_of(found):
    friction = Friction(found.coulomb, found.static_ratio)
    return valve_fit.Plant(found.model, friction, found.offset, found.delay, 1.0, found.presliding, found)


def simulated(found):
    return valve_fit.params(plant_of(found), PERIOD)


def known(found=TRUE, law="dcarc", sensor_delay=0.0):
    """What commissioning makes of a valve ``found``."""
    made = plant_of(found)
    return made, model.Known(made, REST, PERIOD, 10.0, law, sensor_delay)


def test_voltages_and_readings_without_noise_are_the_valve():
    """From a start that is 10 to 50 % off, every number comes out."""
    times = np.arange(7000) * PERIOD
    voltage = np.concatenate(
        [
            3.0 * np.interp(times[:4000], [0.0, 1.0, 3.0, 4.0], [0.0, 1.0, -1.0, 0.0]),
            3.0 * np.sin(2.0 * np.pi * np.cumsum(np.geomspace(1.0, 60.0, 3000)) * PERIOD),
        ]
    )
    wanted = valve_fit.positions(simulated(TRUE), voltage)

    def errors(valve):
        return 100.0 * (valve_fit.positions(simulated(valve), voltage) - wanted)

    begin = TRUE._replace(
        speed=70.0, damping=0.7, coil=0.0025, gain=0.95, sides=0.0, hysteresis=0.1, overlap=0.0, coulomb=0.6,
        presliding=0.03, static_ratio=1.1, offset=0.0, delay=0.0005,
    )  # fmt: skip
    counted = []
    found = valve_fit.refined(begin, PERIOD, errors, lambda: counted.append(1))
    assert found == pytest.approx(TRUE, rel=0.03, abs=2e-3)
    assert len(counted) <= 20 * (2 + len(valve_fit.LOW))  # it has converged long before its bound


@pytest.mark.parametrize("changes", [{}, {"magnet": None, "presliding": 0.0, "friction": Friction(0.5, 1.0)}])
def test_the_hysteresis_is_the_width_of_the_loop_of_a_slow_triangle(changes):
    """As in a data sheet: rising less falling voltage at one position, here on both sides."""
    found = plant_of(TRUE)._replace(**changes)
    rising = np.arange(-8.0, 8.0, 2e-4)  # V
    falling, levels = rising[::-1], [-4.0, 4.0]
    whole = np.concatenate([falling, rising, falling])
    _, up, down = np.split(valve_fit.positions(valve_fit.params(found, PERIOD), whole), 3)
    widths = np.interp(levels, up, rising) - np.interp(levels, down[::-1], rising)
    assert found.hysteresis == pytest.approx(np.mean(widths), rel=0.02)


def test_dcarc_gets_to_know_the_solenoids():
    made, knows = known(sensor_delay=0.0002)
    values = updated(CONTROLLER, defaults(CONTROLLER), model.controller_values(knows, "dcarc"))
    assert values["dcarc.coil"] == TRUE.coil
    assert values["dcarc.hysteresis"] == pytest.approx(0.5 * TRUE.hysteresis)
    assert values["dcarc.sides"] == pytest.approx(math.exp(TRUE.sides) - 1.0)
    assert (values["dcarc.delay"], values["dcarc.actuator_delay"]) == pytest.approx((0.0002, 0.001))
    assert values["dcarc.theta_initial"][2] == TRUE.coulomb
    assert values["dcarc.theta_initial"][6] == -TRUE.offset
    assert values["dcarc.presliding"][1] == TRUE.presliding
    LAWS["dcarc"].build(values)


def test_the_simulated_valve_is_the_one_that_was_found():
    """Through its parameters, with the dead time at its places."""
    made, _ = known()
    values = updated(
        VALVE, defaults(VALVE), {**valve_fit.values(made, REST, PERIOD, 10.0, 0.0002), "lvdt.noise": 0.0}
    )
    assert values["lvdt.delay"] == 0.0002 and values["solenoid.dead_time"] == 0.001
    own = build.valve_params({**values, "lvdt.resolution": 0.0})
    voltage = 3.0 * np.sin(np.arange(2000) * 0.02)
    wanted = valve_fit.positions(simulated(TRUE), voltage)
    assert valve_fit.positions(own, voltage) == pytest.approx(wanted, abs=5e-3)


@pytest.mark.parametrize(("name", "form"), [("A", "plain"), ("B", "reference")])
def test_the_pid_of_internal_model_control_keeps_the_margins_on_a_box_of_valves(name, form):
    """The gain margin of the worst valve is what it was designed for."""
    v = coil.VALVES[name]
    valve = TRUE._replace(
        speed=2.0 * math.pi * v.frequency, damping=v.damping, coil=v.coil, coulomb=v.coulomb, overlap=0.0
    )
    made, knows = known(valve, "pid")
    task = gains.task(Plan(LIMITS, "pid", 0.25, 20, 4, 4, 1, 1), defaults(CONTROLLER), made, knows, REST, 1.0)
    problem = task.problem._replace(values=updated(CONTROLLER, task.problem.values, {"pid.form": form}))
    box = margins.prepared(problem.box)
    starts = designs.starts(LAWS["pid"], problem, box)
    assert len(starts) == len(designs.CUTOFFS) * len(designs.SHAPES) * len(designs.FED)
    found = [margins.margins(LAWS["pid"], LAWS["pid"].build(values), box) for values in starts]
    left = np.repeat([shape[-1] for shape in designs.SHAPES], len(designs.FED))
    for one, wanted in zip(found, np.tile(left, len(designs.CUTOFFS)), strict=True):
        assert float(np.min(one.gain_db)) == pytest.approx(20.0 * math.log10(wanted), abs=1e-3)
    assert min(limits.violation(trial.USUAL, one) for one in found) == 0.0


@given(st.floats(20.0, 300.0), st.floats(0.4, 2.0), st.floats(5e-4, 0.006), st.floats(0.3, 2.0))
def test_the_reciprocal_is_the_power_series_of_the_valve(speed, damping, lag, gain):
    """Of (τs + 1)(s²/ω² + 2ζs/ω + 1)/K, with half a period of the hold."""
    made = TRUE._replace(speed=speed, damping=damping, coil=lag, gain=gain, sides=0.0, overlap=0.0, delay=0.0)
    box = margins.prepared([simulated(made)])
    found = designs.reciprocal(box, 0.05)
    late, rubs = lag + 0.5 * PERIOD, 2.0 * damping / speed
    assert found.c0 == pytest.approx(1.0 / gain, rel=1e-3)
    assert found.c1 == pytest.approx((late + rubs) / gain, rel=0.01)
    second = 1.0 / speed**2 + rubs * late + 0.5 * PERIOD * lag + PERIOD**2 / 6.0
    assert found.c2 == pytest.approx(second / gain, rel=0.05)


@pytest.mark.campaign
def test_a_search_that_begins_far_from_the_valve_goes_on_until_it_is_there():
    """A valve with much friction and hardly any hysteresis: its response has a third of its speed."""
    true = Magnet(
        speed=2.0 * math.pi * 46.24, damping=0.98, coil=0.00516, gain=0.878, sides=-0.05, hysteresis=0.0115,
        overlap=0.0, coulomb=1.077, presliding=0.0266, static_ratio=1.3, offset=0.262, delay=0.00088,
    )  # fmt: skip
    values = valve_fit.values(plant_of(true), Rest(0.0, 0.0012, 0.0), PERIOD, 10.0)
    found = fitted(SupervisedValve(values), LIMITS)
    assert found.magnet is not None and found.error < 1.0
    assert found.magnet.speed == pytest.approx(true.speed, rel=0.05)
    assert found.magnet.coil == pytest.approx(true.coil, rel=0.1)


def test_what_a_law_was_told_of_an_earlier_friction_is_forgotten():
    made, knows = known()
    plan = Plan(LIMITS, "dcarc", 0.25, 20, 4, 4, 1, 1)
    before = defaults(CONTROLLER)
    with_friction = gains.task(plan, before, made, knows, REST, 1.0).knowledge
    linear = valve_fit.Plant(
        TransferFunction((6964.0,), (1.0, 158.3, 7738.0)), Friction(0.25, 1.0), 0.0, 0.0005, 1.0
    )
    about = model.Known(linear, REST, PERIOD, 10.0, "dcarc")
    former = updated(CONTROLLER, before, {**with_friction, "dcarc.learning_path": 1.5})
    later = gains.task(plan, former, linear, about, REST, 1.0).knowledge
    assert later["dcarc.learning_path"] == 0.0
    changed = [
        name for name in first_gains.FRICTION_TERMS if with_friction.get(name, before[name]) != before[name]
    ]
    assert {"dcarc.theta_initial", "dcarc.theta_spread", "dcarc.presliding"} < set(changed)
    assert {name: later[name] for name in changed} == {name: before[name] for name in changed}
    assert not set(gains.task(plan, before, linear, about, REST, 1.0).knowledge) & set(
        first_gains.FRICTION_TERMS
    )


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["A", "B", "C"])
def test_commissioned_dcarc_beats_the_best_pid_on_the_valve(name):
    """Command alone, true error; the PID was found by CMA-ES on the valve itself (issue 32)."""
    best = {"A": 0.0181, "B": 0.0139, "C": 0.0184}[name]
    values = coil.plant(coil.VALVES[name])
    fastest = max(500.0, 2.0 * math.pi * coil.VALVES[name].frequency * 20.0)
    valve = SupervisedValve(values, {"lvdt.max_rate": fastest})
    plan = Plan(LIMITS, "dcarc", 0.25, 200, 6, 32, 1, 2, firm=False)
    found = sequence.Commissioning(valve, plan, valve.values(), Steps()).run()
    assert found.applied["controller"] == "dcarc"
    for previewed in (False, True):
        reached = solenoid.on_the_valve(valve.params, valve.values(), 0.0, previewed)
        assert reached["e_rms"] < best and reached["c_u"] < 0.25


@pytest.mark.parametrize("name", ["A", "C"])
def test_some_designs_keep_the_margins_on_a_box_of_valves(name):
    """Those of research/coil.py itself, for exactly one valve, do not."""
    v = coil.VALVES[name]
    valve = TRUE._replace(
        speed=2.0 * math.pi * v.frequency, damping=v.damping, coil=v.coil, hysteresis=v.hysteresis,
        coulomb=v.coulomb, delay=0.0, overlap=0.0,
    )  # fmt: skip
    made, knows = known(valve)
    plan = Plan(LIMITS, "dcarc", 0.25, 20, 4, 4, 1, 1)
    task = gains.task(plan, defaults(CONTROLLER), made, knows, REST, 1.0)
    box = margins.prepared(task.problem.box)
    starts = designs.starts(LAWS["dcarc"], task.problem, box)
    assert len(starts) == len(dcarc.LOOPS) * len(designs.SHARES)
    missing = [
        limits.violation(trial.USUAL, margins.margins(LAWS["dcarc"], LAWS["dcarc"].build(values), box))
        for values in starts
    ]
    assert min(missing) == 0.0
    assert designs.starts(LAWS["dcarc"], task.problem._replace(values=defaults(CONTROLLER)), box) == []
    assert designs.starts(LAWS["arc"], task.problem, box) == []


@pytest.mark.campaign
def test_a_linear_valve_on_bristles_is_not_described_as_one_with_solenoids():
    """Found with its friction, and with the lag of a coil that it has not as dead time."""
    true = {
        "valve": "custom",
        "numerator": [6964.0],
        "denominator": [1.0, 158.3, 7738.0],
        "friction.coulomb": 0.6,
        "friction.static_ratio": 1.2,
        "friction.presliding": 0.04,
        "lvdt.noise": 0.002,
    }
    found = fitted(SupervisedValve(true), LIMITS)
    assert found.magnet is None and found.error < 1.5
    assert found.presliding == pytest.approx(0.04, rel=0.15)
    assert found.friction.coulomb == pytest.approx(0.6, rel=0.05)
    assert found.model.static_gain == pytest.approx(0.9, rel=0.01)
    assert valve_fit.values(found, REST, PERIOD, 10.0)["valve"] == "custom"


# A valve of third order and 34.8 Hz, as commissioning fitted it by a fourth order: a zero at 6733 rad/s.
FAST = TransferFunction(
    (-3133.8918666956183, 21013033.272194702, 590274685.061358),
    (1.0, 741.1870128263236, 246628.41126594495, 34978195.47116466, 837532906.9849794),
)


# A valve of third order and 6.3 Hz, which a second order takes for one with 4.6 ms of dead time.
SLOW = TransferFunction((341574.4,), (1.0, 267.513, 14527.99, 320269.9))


def known_linear(found, delay=0.0):
    noisy = Rest(0.0, 0.0135, 0.0)
    return model.Known(
        valve_fit.Plant(found, Friction(0.34, 1.37), 0.0, delay, 1.5), noisy, PERIOD, 10.0, "dcarc"
    )


def loop_poles(values, around, delay):
    """Of dcarc with ``values`` ``around`` this model, whose readings are ``delay`` periods late."""
    law = LAWS["dcarc"]
    params = law.build(updated(CONTROLLER, defaults(CONTROLLER), values))
    late = valve.design(around, PERIOD, 10.0, 1.0, valve.NO_DISTURBANCE, IDEAL._replace(delay=delay))
    return linear_loop.dominant_poles(linear_loop.linear_law(law, params), linear_loop.linear_valves([late]))


def test_a_zero_beyond_the_samples_is_taken_out():
    """No lower order is needed. With the model of the D3FXE dcarc came out at 320 mV."""
    found = known_linear(FAST)
    values = model.controller_values(found, "dcarc")
    assert values["dcarc.denominator"] == pytest.approx(FAST.denominator)
    (zero,) = np.roots(values["dcarc.numerator"])
    assert zero == pytest.approx(max(np.roots(FAST.numerator), key=lambda z: -abs(z)))
    assert values["dcarc.numerator"][-1] / values["dcarc.denominator"][-1] == pytest.approx(FAST.static_gain)
    assert found.notes == ()
    assert np.max(np.abs(loop_poles(values, FAST, 0.0))) < 1.0


def test_a_zero_that_cannot_be_inverted_leaves_a_model_of_lower_order():
    """The loop is stable on the valve found."""
    right = TransferFunction((-SLOW.numerator[0] / 200.0, SLOW.numerator[0]), SLOW.denominator)
    found = known_linear(right)
    values = model.controller_values(found, "dcarc")
    assert values["dcarc.model"] == "custom" and len(values["dcarc.denominator"]) == 3
    gain = values["dcarc.numerator"][-1] / values["dcarc.denominator"][-1]
    assert gain == pytest.approx(right.static_gain, rel=0.02)
    assert "dcarc gets a model of order 2 with 4 ms of dead time" in found.notes[0]
    assert "a zero at 200 rad/s and cannot be inverted" in found.notes[0]
    assert np.max(np.abs(loop_poles(values, right, 0.0))) < 1.0


def test_a_third_order_without_zeros_goes_to_dcarc_as_it_is():
    """Before: a model of order 2 with 4 ms of dead time."""
    values = model.controller_values(known_linear(SLOW, 0.0023), "dcarc")
    assert values["dcarc.denominator"] == list(SLOW.denominator)
    assert values["dcarc.actuator_delay"] == pytest.approx(0.0023)
    assert values["dcarc.delay"] == 0.0
    assert np.max(np.abs(loop_poles(values, SLOW, 2.3))) < 1.0
