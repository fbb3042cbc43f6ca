# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the spool command of an axis by adaptive robust control of position, velocity and load force.

By backstepping, after Yao, Bu, Reedy and Chiu, IEEE/ASME Transactions on Mechatronics 5(1), 2000;
docs/explanation/axis_arc.md derives the equations. Three errors: z1 of the position, z2 of the velocity from
the one that z1 asks for, z3 of the load force from the one that z2 asks for. Five numbers are estimated: 1/m,
b/m, Fc/m, Fn/m and the bulk modulus.
"""

import math
from typing import NamedTuple

from valve_control.axis.course import Goal
from valve_control.control.laws.projection import clip
from valve_control.control.plant.saturation import saturate


class Theta(NamedTuple):
    """Five numbers: parameters of the axis, or rates or bounds of them."""

    mobility: float  # 1/kg  1/m
    damping: float  # 1/s  b/m
    friction: float  # m/s²  Coulomb's over m
    force: float  # m/s²  constant forces over m, positive: out
    bulk: float  # Pa


class Model(NamedTuple):
    """What is known of the axis without estimation."""

    area_a: float  # m²
    area_b: float  # m²
    stroke: float  # m
    dead_a: float  # m³
    dead_b: float  # m³
    supply: float  # Pa
    tank: float  # Pa
    flow_pa: float  # m³/s/√Pa  edges, fully open
    flow_pb: float
    flow_at: float
    flow_bt: float
    least_drop: float  # Pa  below which a pressure difference counts as this much


class Params(NamedTuple):
    """Gains and bounds of the law at one sample period."""

    k1: float  # 1/s
    k2: float  # 1/s
    k3: float  # 1/s
    w3: float  # s²/kg²  weight of z3² in the Lyapunov function, over that of z2²
    gamma: Theta  # rates of adaptation
    low: Theta
    high: Theta
    friction_velocity: float  # m/s  in which the sign of the velocity turns
    full_scale: float  # V  spool position at which the edges are fully open
    overlap: float  # V
    overlap_zone: float  # V  command below which the jump is not whole
    limit: float  # V
    period: float  # s
    model: Model


class Measured(NamedTuple):
    """What the law needs to know of the axis."""

    position: float  # m
    velocity: float  # m/s
    pressure_a: float  # Pa
    pressure_b: float  # Pa


class Terms(NamedTuple):
    """What the law computed at this sample."""

    z1: float  # m
    z2: float  # m/s
    z3: float  # N
    opening: float  # -  of the edges, signed
    spool: float  # V


def drop_flow(coefficient: float, difference: float, least: float) -> float:
    """Flow [m³/s] over a fully open edge."""
    size = max(abs(difference), least)
    return coefficient * difference / math.sqrt(size)


def openness(m: Model, x: Measured, outwards: bool) -> float:
    """Rate of the load force per opening and bulk modulus [N/s/Pa]: q of the page."""
    volume_a = m.dead_a + m.area_a * x.position
    volume_b = m.dead_b + m.area_b * (m.stroke - x.position)
    if outwards:
        a = drop_flow(m.flow_pa, m.supply - x.pressure_a, m.least_drop)
        b = drop_flow(m.flow_bt, x.pressure_b - m.tank, m.least_drop)
    else:
        a = drop_flow(m.flow_at, x.pressure_a - m.tank, m.least_drop)
        b = drop_flow(m.flow_pb, m.supply - x.pressure_b, m.least_drop)
    least = (
        0.1 * math.sqrt(m.least_drop) * (m.flow_pa * m.area_a / volume_a + m.flow_bt * m.area_b / volume_b)
    )
    return max(least, m.area_a * a / volume_a + m.area_b * b / volume_b)


def stiffness(m: Model, position: float) -> float:
    """Rate of the load force per velocity and bulk modulus [m], of both rooms: h of the page."""
    volume_a = m.dead_a + m.area_a * position
    volume_b = m.dead_b + m.area_b * (m.stroke - position)
    return m.area_a * m.area_a / volume_a + m.area_b * m.area_b / volume_b


def adapted(low: float, high: float, value: float, rate: float, period: float) -> float:
    """Estimate one period later, held within its bounds."""
    return clip(value + period * rate, low, high)


def step(p: Params, t: Theta, goal: Goal, jerk: float, x: Measured) -> tuple[float, Theta, Terms]:
    """Compute one sample with the estimates ``t``; returns spool command [V], next ones and terms.

    ``jerk`` [m/s³]: of the goal. The estimates rest while the command is at its limit.
    """
    m = p.model
    v = x.velocity
    load = x.pressure_a * m.area_a - x.pressure_b * m.area_b
    ratio = v / p.friction_velocity
    sign = math.tanh(ratio)
    slope = (1.0 - sign * sign) / p.friction_velocity

    z1 = x.position - goal.position
    rate = v - goal.velocity  # of z1
    z2 = rate + p.k1 * z1
    wanted = goal.acceleration - p.k1 * rate  # acceleration that z1 asks for
    acceleration = t.mobility * load - t.damping * v - t.friction * sign + t.force  # by the estimates

    # Force that z2 asks for, and its derivatives.
    needed = wanted + t.damping * v + t.friction * sign - t.force - p.k2 * z2 - z1
    desired = needed / t.mobility
    z3 = load - desired
    by_velocity = (-p.k1 + t.damping + t.friction * slope - p.k2) / t.mobility
    by_position = (-p.k1 * p.k2 - 1.0) / t.mobility
    by_time = (
        jerk + p.k1 * goal.acceleration + p.k2 * (goal.acceleration + p.k1 * goal.velocity) + goal.velocity
    ) / t.mobility

    # Adaptation.
    weight = z2 - p.w3 * z3 * by_velocity
    h = stiffness(m, x.position)
    theta = Theta(
        adapted(p.low.mobility, p.high.mobility, t.mobility, p.gamma.mobility * weight * load, p.period),
        adapted(p.low.damping, p.high.damping, t.damping, -p.gamma.damping * weight * v, p.period),
        adapted(p.low.friction, p.high.friction, t.friction, -p.gamma.friction * weight * sign, p.period),
        adapted(p.low.force, p.high.force, t.force, p.gamma.force * weight, p.period),
        t.bulk,
    )
    by_estimates = (
        v * (theta.damping - t.damping)
        + sign * (theta.friction - t.friction)
        - (theta.force - t.force)
        - desired * (theta.mobility - t.mobility)
    ) / (t.mobility * p.period)

    # Opening that z3 asks for.
    moved = by_position * v + by_velocity * acceleration + by_time + by_estimates
    pushed = moved - p.k3 * z3 - t.mobility * z2 / p.w3
    compressed = pushed / t.bulk + h * v
    outwards = compressed > 0.0
    q = openness(m, x, outwards)
    opening = compressed / q
    beyond = opening * (p.full_scale - p.overlap)
    spool = beyond + p.overlap * saturate(beyond / p.overlap_zone, 1.0)
    command = saturate(spool, p.limit)
    if command != spool:
        return command, t, Terms(z1, z2, z3, opening, command)
    change = p.gamma.bulk * p.w3 * z3 * (q * opening - h * v)
    bulk = adapted(p.low.bulk, p.high.bulk, t.bulk, change, p.period)
    theta = Theta(theta.mobility, theta.damping, theta.friction, theta.force, bulk)
    return command, theta, Terms(z1, z2, z3, opening, command)
