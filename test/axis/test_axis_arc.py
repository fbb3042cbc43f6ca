# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The axis's adaptive robust control on the equations that it assumes, sampled very finely."""

import math

import numpy as np
import pytest

from research.axes import study
from valve_control.axis import axis_arc
from valve_control.axis.axis_arc import Measured, Model, Theta
from valve_control.axis.axis_parameters import axis_params
from valve_control.axis.course import Goal
from valve_control.parameter import number

STEP = 2e-5  # s
K1, K2, K3 = 25.0, 60.0, 80.0
KAPPA = 60.0  # 1/s
BULK = 1.4e9
SWIFT = 0.02  # m/s  estimates' error over their range that weighs like 1 m/s


def scaled(theta, factors):
    return Theta(*(v * f for v, f in zip(theta, factors, strict=True)))


def drawn(seed, spread=0.3):
    """Law and true parameters of a random axis of the study, estimates off by up to ``spread``."""
    random = np.random.default_rng(seed)
    values = study.random_axis(seed)
    a = axis_params(values)
    mass = a.load.mass
    rod = a.supply.tank * (a.cylinder.area_a - a.cylinder.area_b)
    theta = Theta(1.0 / mass, a.load.damping / mass, a.load.coulomb / mass, (500.0 + rod) / mass, BULK)
    k, c = a.coefficients, a.cylinder
    model = Model(
        c.area_a, c.area_b, c.stroke, c.dead_a, c.dead_b, number(values, "supply.pressure"), a.supply.tank,
        k.pa, k.pb, k.at, k.bt, 1e5,
    )  # fmt: skip
    low, high = scaled(theta, [0.5] * 5), scaled(theta, [1.6] * 5)
    p = axis_arc.Params(
        k1=K1,
        k2=K2,
        k3=K3,
        w3=1.0 / (mass * KAPPA) ** 2,
        gamma=Theta(*(((h - q) / SWIFT) ** 2 for q, h in zip(low, high, strict=True))),
        low=low,
        high=high,
        friction_velocity=0.02,
        full_scale=10.0,
        overlap=0.0,
        overlap_zone=0.05,
        limit=100.0,
        period=STEP,
        model=model,
    )
    begin = scaled(theta, random.uniform(1.0 - spread, 1.0 + spread, 5))
    return p, theta, begin, random


def energy(p, theta, estimates, terms):
    """V of the page, with the part of the estimates."""
    off = sum((e - t) ** 2 / g for e, t, g in zip(estimates, theta, p.gamma, strict=True))
    return 0.5 * (terms.z1**2 + terms.z2**2 + p.w3 * terms.z3**2 + off)


def rate_of_energy(seed):
    """dV/dt at a random state of a random axis by the axis's own equations, and what the theorem says it is.

    The law is asked twice, a moment ``h`` apart; in between the axis moves by its equations. The second
    answer is only looked at for its errors. Two such differences leave an error of second order.
    """
    p, theta, begin, random = drawn(seed)
    p = p._replace(limit=1e6)  # no saturation
    m = p.model
    x, v = 0.25 + random.uniform(-0.1, 0.1), random.uniform(-0.3, 0.3)
    pa, pb = 40e5, random.uniform(20e5, 60e5)
    goal = Goal(x + random.normal(0.0, 0.002), v + random.normal(0.0, 0.02), random.uniform(-2.0, 2.0))
    jerk, d = random.uniform(-40.0, 40.0), random.normal(0.0, 0.5)
    off = axis_arc.step(p, begin, goal, jerk, Measured(x, v, pa, pb))[2].z3
    pa = min(max(pa - off / m.area_a + random.normal(0.0, 2e5), 5e5), m.supply - 5e5)
    sign = math.tanh(v / p.friction_velocity)
    force = m.area_a * pa - m.area_b * pb
    a = theta.mobility * force - theta.damping * v - theta.friction * sign + theta.force + d

    def difference(h):
        law = p._replace(period=h)
        _, s, one = axis_arc.step(law, begin, goal, jerk, Measured(x, v, pa, pb))
        flows = (
            ((m.flow_pa, m.supply - pa), (m.flow_bt, pb - m.tank))
            if one.opening > 0.0
            else ((m.flow_at, pa - m.tank), (m.flow_pb, m.supply - pb))
        )
        qa, qb = (k * math.copysign(math.sqrt(abs(dp)), dp) for k, dp in flows)
        rate_a = theta.bulk * (qa * one.opening - m.area_a * v) / (m.dead_a + m.area_a * x)
        rate_b = theta.bulk * (m.area_b * v - qb * one.opening) / (m.dead_b + m.area_b * (m.stroke - x))
        then = Goal(
            goal.position + h * goal.velocity,
            goal.velocity + h * goal.acceleration,
            goal.acceleration + h * jerk,
        )
        later = Measured(x + h * v, v + h * a, pa + h * rate_a, pb + h * rate_b)
        after = axis_arc.step(law, s, then, jerk, later)[2]
        return (energy(p, theta, s, after) - energy(p, theta, begin, one)) / h, one

    h = 1e-8
    (whole, one), (half, _) = difference(h), difference(0.5 * h)
    loss = p.k1 * one.z1**2 + p.k2 * one.z2**2 + p.k3 * p.w3 * one.z3**2
    t = begin
    slope = (1.0 - sign * sign) / p.friction_velocity
    by_velocity = (-p.k1 + t.damping + t.friction * slope - p.k2) / t.mobility
    return 2.0 * half - whole, -loss + (one.z2 - p.w3 * one.z3 * by_velocity) * d, loss


def test_the_lyapunov_function_falls_as_the_theorem_says_at_any_state():
    """Parameters off by up to 30 % do not occur in dV/dt: part B. A disturbance does, as the page says."""
    for seed in range(100):
        found, expected, loss = rate_of_energy(seed)
        assert found == pytest.approx(expected, abs=2e-3 * loss + 1e-9), seed
