# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Friction from a slow triangle: what random valves have comes out, and other tests are refused."""

import numpy as np
import pytest

from research import comparison
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant.transfer_functions import FOURTH_ORDER
from valve_control.control.simulation import batch
from valve_control.design.identification import (
    bode_fit,
    characteristic,
    experiment,
    first_gains,
    friction,
    theta,
)
from valve_control.design.identification.experiment import Experiment
from valve_control.design.identification.lvdt import Lvdt
from valve_control.parameter import ParameterError, defaults, updated

PERIOD, U_MAX = 0.001, 10.0
OPEN = {"controller": "open_loop", "open_loop.static_gain": 1.0, "command_limit": 100.0}
STRIBECK = {
    "friction.coulomb": 1.16,
    "friction.static_ratio": 1.25,
    "friction.stribeck_velocity": 0.017,
    "friction.presliding": 0.02,
    "lvdt.noise": 0.0056,
    "lvdt.resolution": 0.0037,
}


def made(voltage, position):
    return Experiment("", PERIOD, voltage, position, (), U_MAX, ())


def triangle(**changes):
    return build.commands(experiment.test_values({**friction.TEST, **changes}, PERIOD))


def lag_with_flow(plant):
    """Lag of the valve with its flow force, which feeds the position back."""
    feedback = plant.disturbance.flow_force * FOURTH_ORDER.static_gain * plant.gain_scale
    (n1, n0), (d1, d0) = FOURTH_ORDER.numerator[-2:], FOURTH_ORDER.denominator[-2:]
    return (d1 / d0 - n1 / n0) / (1.0 + feedback)


def test_friction_offset_and_presliding_of_random_valves():
    """Coulomb within 5 mV, offset within 1 mV; presliding within 12 % where friction is 0.2 V or more."""
    plants = comparison.valves(32, 11, False)
    voltage = triangle()
    traces = np.empty((len(plants), len(voltage), 3))
    params = LAWS["open_loop"].build(updated(CONTROLLER, defaults(CONTROLLER), OPEN))
    rows = batch.records(plants)
    batch.simulate(batch.Batch("open_loop", params, rows, np.arange(len(plants)), voltage), 1, traces)
    told = 0
    for plant, trace in zip(plants, traces, strict=True):
        found = characteristic.friction_and_curve(made(voltage, trace[:, 1]), lag_with_flow(plant))[0]
        true = plant.disturbance
        assert abs(found.coulomb - true.coulomb) < 0.005
        assert abs(found.offset - true.offset) < 0.001
        assert found.static_gain == pytest.approx(
            1.0 / (1.0 / (FOURTH_ORDER.static_gain * plant.gain_scale) + true.flow_force), rel=0.002
        )
        if true.coulomb >= 0.2 and found.presliding:
            told += 1
            assert found.presliding == pytest.approx(true.presliding, rel=0.12)
    assert told >= 0.85 * sum(plant.disturbance.coulomb >= 0.2 for plant in plants)


def test_friction_taken_off_gives_the_model_back():
    """A stepped sine with friction of 1.16 V: static gain within 1 % instead of some per cent less."""
    plant = updated(VALVE, defaults(VALVE), STRIBECK)
    controller = defaults(CONTROLLER)
    sine = {"amplitude": 6.0, "steps": 16, "cycles": 4, "step_time": 0.8, "frequency": 0.8}
    tested = experiment.simulated(controller, plant, experiment.test_values(sine, PERIOD))
    slow = experiment.simulated(controller, plant, experiment.test_values(friction.TEST, PERIOD))
    found = characteristic.friction_and_curve(slow, friction.lag_of(FOURTH_ORDER, 0.0))[0]
    assert found.coulomb == pytest.approx(1.16, abs=0.005)
    assert found.presliding == pytest.approx(0.02, rel=0.05)
    missed = []
    for one in (tested, friction.without(tested, found)):
        second = bode_fit.fit(experiment.estimate(one, 0.4, None), 2)
        measured = experiment.estimate(one, 0.4, None)
        fit = bode_fit.fit(measured, 4)
        missed.append(abs(fit.model.static_gain / FOURTH_ORDER.static_gain - 1.0))
    assert missed[1] < 0.01 < missed[0]
    suggested = theta.suggest(measured, second, fit, U_MAX)
    lvdt = Lvdt(0.0056, 0.0037)
    known = first_gains.KnownValve(fit.model, 0.0, suggested, lvdt, PERIOD, U_MAX, found)
    values = first_gains.first(known).values
    assert values["dcarc.theta_initial"][2] == pytest.approx(1.16, abs=0.005)
    assert values["dcarc.presliding"][1] == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize(
    ("voltage", "gain", "text"),
    [
        (4.0 * np.sin(2.0 * np.pi * 0.2 * np.arange(20000) * PERIOD), 0.8, "beside straight lines"),
        (triangle(cycles=2), 0.8, "has 3 whole strokes"),
        (triangle(frequency=4.0), 0.8, "must take"),
        (3.0 * triangle(), 0.8, "saturates at u_max, 10 V"),
        (triangle(), -1.0, "does not follow"),
    ],
)
def test_what_is_no_slow_triangle_is_refused(voltage, gain, text):
    with pytest.raises(ParameterError, match=text):
        characteristic.friction_and_curve(made(voltage, gain * voltage), friction.lag_of(FOURTH_ORDER, 0.0))
