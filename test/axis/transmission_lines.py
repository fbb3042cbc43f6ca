"""The position servo once more by another method: rooms as transmission lines (Krus et al. 1990).

In it pressures travel as waves, half a step into a room and half a step out: with the wave c and the
impedance Z = N·β·T/(2V(1 - α)) of each of its N ports, p = c + Z·q. What sits between rooms (spool edges,
piston, relief valve) is solved at each step for the flows. The method behind Hopsan; written from the
equations of its documentation, with other numerics for the relief valve.
"""

import math

import numpy as np
from numba import njit

BETA, AREA, MASS, SPRING = 1e9, 1e-3, 100.0, 100.0
TANK, DEAD, STROKE, SUPPLY = 1e5, 3e-4, 1.0, 1e-3
EDGE = 0.67 * math.pi * 0.01 * math.sqrt(2.0 / 890.0)
OVERLAP, SPOOL_LIMIT, SPOOL_OMEGA = 1e-4, 0.01, 200.0
PUMP, PUMP_LEAK = 200.0 * 25e-5 / (2.0 * math.pi), 1e-12
OPENS, SLOPE, NOMINAL, FULL, LAG = 200e5, 1e-8, math.sqrt(70e5), 0.01, 1e-3
ALPHA_SUPPLY, ALPHA_CYLINDER = 0.3, 0.1
KP, KI = 0.0264249, 0.000672426


@njit
def turbulent(k, c1, c2, z):
    """Flow from wave ``c1`` to ``c2`` through both impedances together, z."""
    lost = 0.5 * k * z
    q = k * (math.sqrt(abs(c1 - c2) + lost * lost) - lost)
    return q if c1 > c2 else -q


@njit
def waves(c, q, z, alpha):
    """Waves that come back from a room with as many ports as ``c`` has."""
    mean = np.mean(c + 2.0 * z * q)
    c[:] = alpha * c + (1.0 - alpha) * (2.0 * mean - c - 2.0 * z * q)


@njit
def position_servo(period, n):
    """Rows of time, position, goal, spool [m] and relief opening, one a ``period``."""
    out = np.zeros((n, 5))
    cs, ca, cb = np.full(3, TANK), np.full(3, TANK), np.full(3, TANK)
    qs, qa, qb = np.zeros(3), np.zeros(3), np.zeros(3)
    x = v = relief = wanted_before = integral = 0.0
    x_before = push = push_before = 0.0
    u1 = u2 = xv1 = xv2 = 0.0
    zs = 1.5 * BETA / SUPPLY * period / (1.0 - ALPHA_SUPPLY)
    for i in range(n):
        goal = 0.2 if i * period < 1.0 - 1e-9 else 0.7
        integral += (goal - x) * period
        u = max(-SPOOL_LIMIT, min(SPOOL_LIMIT, KP * (goal - x) + KI * integral))

        za = 1.5 * BETA / (DEAD + AREA * x) * period / (1.0 - ALPHA_CYLINDER)
        zb = 1.5 * BETA / (DEAD + AREA * (STROKE - x)) * period / (1.0 - ALPHA_CYLINDER)
        waves(cs, qs, zs, ALPHA_SUPPLY)
        waves(ca, qa, za, ALPHA_CYLINDER)
        waves(cb, qb, zb, ALPHA_CYLINDER)

        a2 = 4.0 / (period * SPOOL_OMEGA) ** 2  # the spool, by the bilinear transform
        a1 = 4.0 / (period * SPOOL_OMEGA)
        xv = (u + 2.0 * u1 + u2 - (2.0 - 2.0 * a2) * xv1 - (1.0 + a2 - a1) * xv2) / (1.0 + a2 + a1)
        xv = max(-SPOOL_LIMIT, min(SPOOL_LIMIT, xv))
        u2, u1, xv2, xv1 = u1, u, xv1, xv

        out_, in_ = EDGE * max(0.0, xv - OVERLAP), EDGE * max(0.0, -xv - OVERLAP)
        c1, c2, c3, z1, z2, z3 = cs[1], ca[0], cb[0], zs, za, zb
        for _ in range(2):  # a port where the pressure would be negative has none
            pa, pb = turbulent(out_, c1, c2, z1 + z2), turbulent(in_, c1, c3, z1 + z3)
            at, bt = turbulent(in_, c2, TANK, z2), turbulent(out_, c3, TANK, z3)
            if c1 - (pa + pb) * z1 < 0.0:
                c1 = z1 = 0.0
            if c2 + (pa - at) * z2 < 0.0:
                c2 = z2 = 0.0
            if c3 + (pb - bt) * z3 < 0.0:
                c3 = z3 = 0.0
        qs[1], qa[0], qb[0] = -(pa + pb), pa - at, pb - bt
        qs[2] = (PUMP + PUMP_LEAK * (TANK - cs[2])) / (1.0 + zs * PUMP_LEAK)

        new = relief
        for _ in range(30):
            pressure = cs[0] - zs * turbulent(new, cs[0], TANK, zs)
            wanted = (pressure - OPENS) / (NOMINAL / SLOPE + max(0.0, pressure - TANK) / (SLOPE * NOMINAL))
            wanted = max(0.0, min(FULL / NOMINAL, wanted))
            half = 0.5 * period
            found = (relief * (LAG - half) + half * (wanted + wanted_before)) / (LAG + half)
            new += 0.5 * (found - new)
        relief, wanted_before = new, wanted
        qs[0] = -turbulent(relief, cs[0], TANK, zs)

        drag_a, drag_b, from_a, from_b = za, zb, ca[1], cb[1]
        if z2 == 0.0:
            drag_a, from_a = 0.0, max(0.0, from_a)
        if z3 == 0.0:
            drag_b, from_b = 0.0, max(0.0, from_b)
        force, drag = AREA * (from_a - from_b), AREA * AREA * (drag_a + drag_b)
        b2, b1 = 4.0 * MASS / period**2, 2.0 * drag / period  # the mass, by the bilinear transform
        moved = force + 2.0 * push + push_before - (2.0 * SPRING - 2.0 * b2) * x
        moved = (moved - (SPRING + b2 - b1) * x_before) / (SPRING + b2 + b1)
        gained = force - SPRING * moved + push - SPRING * x
        v = (gained + (2.0 * MASS / period - drag) * v) / (2.0 * MASS / period + drag)
        push_before, push, x_before, x = push, force, x, moved
        qa[1], qb[1] = -AREA * v, AREA * v
        out[i] = (i + 1) * period, x, goal, xv, relief
    return out
