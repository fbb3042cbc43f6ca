# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates a position servo by transmission lines, with the steps and in the order of Hopsan.

The method (Krus, Jansson, Palmberg and Weddfelt, "Distributed simulation of hydromechanical systems", 1990):
a room of oil is a star of lines, one for each of its N ports, through which pressure travels in one step. A
port shows the outside a wave c and an impedance Z = N·β·T/(2V·(1 - α)), so that p = c + Z·q there; what sits
between the rooms is solved at each step for the flows, each part by itself. α damps the waves. In each step
come first the signals, with what was measured a step before, then the waves, then the flows.
docs/explanation/axis.md says what that is for.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.axis import axis, axis_pid
from valve_control.axis.axis import opening
from valve_control.control.plant.saturation import saturate

Array = npt.NDArray[np.float64]
PERIOD = 1e-4  # s  of the example
SUPPLY_DAMPING, CYLINDER_DAMPING = 0.3, 0.1  # -  α of the example and of Hopsan's cylinder
PORTS = 3  # of each of the three rooms


class Servo(NamedTuple):
    """A machine with a pump, its upper level, its valve of second order, and the step that it makes."""

    axis: axis.Params
    upper: axis_pid.Params
    spool: tuple[float, float, float]  # 1/s², 1/s, -  of w²/(s² + 2ζws + w²): w², 2ζw, 1
    before: float  # m  goal
    after: float  # m
    pause: float  # s


class Lag(NamedTuple):
    """Inputs and outputs of a lag of second order, one and two steps ago."""

    u1: float
    u2: float
    y1: float
    y2: float


class Relief(NamedTuple):
    """Relief valve: opening, balance of its forces and pressure at its port, of the step before."""

    opening: float  # m³/s/√Pa
    balance: float  # m³/s/√Pa
    pressure: float  # Pa


def turbulent(k: float, c1: float, c2: float, z: float) -> float:
    """Flow [m³/s] q = k·√(p1 - p2) from wave ``c1`` to ``c2`` [Pa]; ``z``: both impedances together."""
    lost = 0.5 * k * z
    q = k * (math.sqrt(abs(c1 - c2) + lost * lost) - lost)
    return q if c1 > c2 else -q


def returned(c: Array, q: Array, z: float, damping: float) -> None:
    """Put into ``c`` [Pa] the waves that come back from a room after the flows ``q`` [m³/s] into it."""
    mean = np.mean(c + 2.0 * z * q)
    c[:] = damping * c + (1.0 - damping) * (2.0 * mean - c - 2.0 * z * q)


def followed(spool: tuple[float, float, float], s: Lag, u: float, limit: float, period: float) -> Lag:
    """Second-order lag one step later, by the bilinear transform; ``limit`` is that of its output."""
    w2, damped, mass = spool
    a0 = w2 + 2.0 * damped / period + 4.0 * mass / period**2
    a1 = 2.0 * w2 - 8.0 * mass / period**2
    a2 = w2 - 2.0 * damped / period + 4.0 * mass / period**2
    y = (w2 * (u + 2.0 * s.u1 + s.u2) - a1 * s.y1 - a2 * s.y2) / a0
    return Lag(u, s.u1, saturate(y, limit), s.y1)


def relieved(p: axis.Supply, s: Relief, c: float, z: float, period: float) -> tuple[Relief, float]:
    """Relief valve one step later, and its flow [m³/s] into a port with wave ``c`` and impedance ``z``.

    Its balance b1·k = p - p_o, b1 = √p_n/k_cs + Δ/(k_cf·√p_n), Δ = p - p_t, meets p = c - z·k·√Δ, which is
    made linear about the step before (k', Δ'): p = γc - b2·(k - k'/2), γ = 2√Δ'/(2√Δ' + z·k'), b2 = γ·z·√Δ'.
    So the lag of time τ in k becomes one of τ/(1 + b2/b1). The tank's pressure is left out of the linear
    part. Not the balance is limited, only the opening.
    """
    over = s.pressure - p.tank
    root = math.sqrt(abs(over))
    b1 = p.relief_spring + max(0.0, over) * p.relief_flow_force
    share = 2.0 * root / (2.0 * root + z * s.opening) if root > 0.0 or s.opening > 0.0 else 1.0
    b2 = share * z * root
    balance = (share * c + 0.5 * b2 * s.opening - p.relief_pressure) / (b1 + b2)
    lag = 2.0 * p.relief_time / (1.0 + b2 / b1)
    k = (period * (balance + s.balance) + (lag - period) * s.opening) / (lag + period)
    k = max(0.0, min(p.relief_limit, k))
    q = turbulent(k, c, p.tank, z)
    pressure = c - z * q
    if pressure < 0.0:
        q = turbulent(k, 0.0, p.tank, 0.0)
        pressure = 0.0
    return Relief(k, balance, pressure), -q


def pumped(p: axis.Supply, c: float, z: float) -> float:
    """Flow [m³/s] of the pump into a port with wave ``c`` [Pa] and impedance ``z``."""
    q = (p.pump_flow + p.pump_leakage * (p.tank - c)) / (1.0 + z * p.pump_leakage)
    if c + z * q < 0.0:
        q = p.pump_flow + p.pump_leakage * p.tank
    return q


def spent(
    p: axis.Params, spool: float, c: tuple[float, float, float], z: tuple[float, float, float]
) -> tuple[float, float, float, bool, bool]:
    """Flows [m³/s] of the spool's edges into supply, a and b, and whether a and b are empty.

    ``c`` [Pa] and ``z`` are of the same three ports. A port at which the pressure would be negative has none:
    wave and impedance are 0 there.
    """
    k, o, at = p.coefficients, p.overlaps, spool / p.full_scale
    pa, pb = k.pa * opening(at, o.pa), k.pb * opening(-at, o.pb)
    ta, tb = k.at * opening(-at, o.at), k.bt * opening(at, o.bt)
    (c1, c2, c3), (z1, z2, z3), tank = c, z, p.supply.tank
    empty_a = empty_b = False
    into_a = into_b = out = 0.0
    for again in range(2):
        qa, qb = turbulent(pa, c1, c2, z1 + z2), turbulent(pb, c1, c3, z1 + z3)
        into_a, into_b = qa - turbulent(ta, c2, tank, z2), qb - turbulent(tb, c3, tank, z3)
        out = -qa - qb
        if again == 0:
            empty_a, empty_b = c2 + into_a * z2 < 0.0, c3 + into_b * z3 < 0.0
            if c1 + out * z1 < 0.0:
                c1 = z1 = 0.0
            if empty_a:
                c2 = z2 = 0.0
            if empty_b:
                c3 = z3 = 0.0
    return out, into_a, into_b, empty_a, empty_b


def position_servo(p: Servo, period: float, steps: int) -> Array:
    """Simulate ``p`` from rest at 0 m and tank pressure with lines of a ``period`` [s].

    Returns rows of time [s], measured position [m], goal [m], spool [V] and opening of the relief
    valve [m³/s/√Pa], the first one at time 0.
    """
    c, load, supply, upper = p.axis.cylinder, p.axis.load, p.axis.supply, p.upper
    out = np.zeros((steps + 1, 5))
    out[0, 2] = p.before
    # Waves and flows; ports of the supply: relief valve, spool, pump; of a and b: spool, piston, leakage.
    cs, ca, cb = np.full(PORTS, supply.tank), np.full(PORTS, supply.tank), np.full(PORTS, supply.tank)
    qs, qa, qb = np.zeros(PORTS), np.zeros(PORTS), np.zeros(PORTS)
    half = 0.5 * PORTS * p.axis.bulk_modulus * period
    zs = half / supply.volume / (1.0 - SUPPLY_DAMPING)
    spring, from_load, to_load = load.stiffness * period, 0.0, 0.0  # one more line
    time = x = v = push = integral = 0.0
    error = p.before  # of the step before
    piston, spool, relief = Lag(0.0, 0.0, 0.0, 0.0), Lag(0.0, 0.0, 0.0, 0.0), Relief(0.0, 0.0, supply.tank)
    empty_a = empty_b = False
    for i in range(steps):
        time += period
        goal = p.before if time < p.pause else p.after
        measured = x
        integral += 0.5 * period * (error + goal - x)
        error = goal - x
        u = saturate((upper.kp * error + upper.ki * integral) / upper.gain_out, upper.limit)

        volume_a, volume_b = axis.volumes(c, x)
        za = half / volume_a / (1.0 - CYLINDER_DAMPING)
        zb = half / volume_b / (1.0 - CYLINDER_DAMPING)
        qa[1], qb[1] = -c.area_a * v, c.area_b * v
        returned(cs, qs, zs, SUPPLY_DAMPING)
        returned(ca, qa, za, CYLINDER_DAMPING)
        returned(cb, qb, zb, CYLINDER_DAMPING)
        from_load, to_load = to_load, from_load + 2.0 * spring * v
        # An empty room neither pulls nor damps the piston.
        force = c.area_a * (max(0.0, ca[1]) if empty_a else ca[1]) - from_load
        force -= c.area_b * (max(0.0, cb[1]) if empty_b else cb[1])
        drag = load.damping + spring
        drag += 0.0 if empty_a else c.area_a**2 * za
        drag += 0.0 if empty_b else c.area_b**2 * zb

        # m·x'' + drag·x' = force for the position, m·v' + drag·v = force for the velocity, both bilinear.
        b0, b2 = load.mass + 0.5 * drag * period, load.mass - 0.5 * drag * period
        forces = force + 2.0 * piston.u1 + piston.u2
        x = (0.25 * period**2 * forces + 2.0 * load.mass * piston.y1 - b2 * piston.y2) / b0
        v = (0.5 * period * (force + push) + b2 * v) / b0
        piston, push = Lag(force, piston.u1, x, piston.y1), force

        relief, qs[0] = relieved(supply, relief, cs[0], zs, period)
        qs[2] = pumped(supply, cs[2], zs)
        spool = followed(p.spool, spool, u, p.axis.full_scale, period)
        ports = (cs[1], ca[0], cb[0]), (zs, za, zb)
        qs[1], qa[0], qb[0], empty_a, empty_b = spent(p.axis, spool.y1, ports[0], ports[1])
        out[i + 1] = time, measured, goal, spool.y1, relief.opening
    return out
