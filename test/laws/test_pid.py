import math

import numpy as np
import pytest
import sympy as sp

from valve_control.laws import pid
from valve_control.laws.signals import Start
from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, defaults, updated


def params(**changes):
    values = {"pid." + k: v for k, v in changes.items()}
    return build.pid_params(updated(CONTROLLER, defaults(CONTROLLER), values))


def test_pole_placement_gives_the_published_gains():
    kp, ki, kd = pid.place_poles(7.0, 20.0, 1200.0, 1200.0)
    assert (round(ki, 3), round(kd, 3)) == (70.901, 0.093)
    assert math.isclose(kp, 3.837, abs_tol=1e-3)  # 3.8361: the print's last digit is off by one


def test_characteristic_equations_of_both_forms():
    """(55) belongs to model terms of the reference; (54) as printed cancels θ1 and θ2."""
    s, x, r = sp.symbols("s x r")
    t1, t2, t3, kp, ki, kd = sp.symbols("t1 t2 t3 kp ki kd", positive=True)
    feedback = -(kp + ki / s + kd * s) * (x - r)
    plant = (s**2 + t1 * s + t2) * x
    for model, expected in (
        ((s**2 * r + t1 * s * r + t2 * r) / t3, s**3 + (t1 + kd * t3) * s**2 + (t2 + kp * t3) * s + ki * t3),
        ((s**2 * r + t1 * s * x + t2 * x) / t3, s**3 + kd * t3 * s**2 + kp * t3 * s + ki * t3),
    ):
        equation = sp.expand((plant - t3 * (model + feedback)) * s)
        assert sp.expand(equation.coeff(x, 1) - expected) == 0


def test_one_step_in_the_head():
    """Plain form at rest at 1 V, command 2 V: ff 1.18*2, P 15*1, I and D still at their start."""
    p = params(form="plain", kp=2.0, ki=10.0, kd=0.0, static_feedforward=1.18)
    s = pid.initial(p, Start(1.0, 1.18, 1.0, 0.0, 0.0))
    voltage, s, terms = pid.step(p, s, 2.0, 1.0, 0.0)
    assert math.isclose(terms.feedforward_voltage, 2.36)
    assert math.isclose(terms.proportional_voltage, 2.0)
    assert terms.derivative_voltage == 0.0
    assert math.isclose(voltage, 4.36)
    assert math.isclose(s.integral, -0.01)


@pytest.mark.parametrize("form", ["paper", "reference", "plain"])
def test_integrator_rests_in_saturation_and_leaves_it(form):
    p = params(form=form, ki=1000.0)
    s = pid.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    seen = []
    for _ in range(2000):
        voltage, s, _ = pid.step(p, s, 9.0, 0.0, 0.0)
        assert abs(voltage) <= p.u_max
        seen.append(s.integral)
    assert abs(seen[-1]) < 2.0 * p.u_max
    assert seen[-1] == seen[1000]


@pytest.mark.parametrize("form", ["paper", "reference", "plain"])
def test_takes_over_without_a_bump(form):
    p = params(form=form)
    s = pid.initial(p, Start(1.3, 2.7, 1.3, 0.0, 0.0))
    voltage, _, _ = pid.step(p, s, 1.3, 1.3, 0.0)
    assert np.isclose(voltage, 2.7)
