# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from valve_control.control.laws import pid
from valve_control.control.laws.signals import Start
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import defaults, updated


def params(**changes):
    values = {"pid." + k: v for k, v in changes.items()}
    return pid.build(updated(CONTROLLER, defaults(CONTROLLER), values))


@pytest.mark.parametrize(("form", "own"), [("reference", 1.0), ("paper", 0.0)])
def test_characteristic_equations_of_both_forms(form, own):
    """(55) belongs to model terms of the reference; with measured ones, as in (54), a1 and a0 cancel.

    The law's voltage on the valve that it knows: z1'' + (own·a1 + kd·b0)·z1' + (own·a0 + kp·b0)·z1
    + ki·b0·∫z1 = 0, at any position, velocity, reference and integral.
    """
    p = params(form=form, kp=3.1, ki=52.0, kd=0.07, theta=[31.0, 1350.0, 1180.0])._replace(u_max=1e6)
    rng = np.random.default_rng(2)
    for _ in range(50):
        x, before, reference, command = (float(v) for v in rng.normal(size=4))
        rate, velocity, integral = (float(v) for v in rng.normal(size=3) * [20.0, 20.0, 1.0])
        s = pid.State(
            pid.reshaping.State(reference, rate), pid.velocity.State(before, velocity), integral, 1.0
        )
        voltage, after, terms = pid.step(p, s, command, x, 0.0)
        accel = p.b0 * voltage - p.a1 * terms.velocity - p.a0 * x
        z1, z1_dot = x - reference, terms.velocity - rate
        z1_ddot = -(own * p.a1 + p.kd * p.b0) * z1_dot - (own * p.a0 + p.kp * p.b0) * z1 - p.b0 * integral
        assert accel - terms.reference_accel == pytest.approx(z1_ddot, rel=1e-9)
        assert after.integral - integral == pytest.approx(p.ki * z1 * p.period, rel=1e-9)


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
