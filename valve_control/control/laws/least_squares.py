# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Nine weights fitted to a measured number, each with a variance of its own: pure scalar steps.

The Kalman filter of constant weights (recursive least squares) of which only the variances are kept, not the
covariances. A weight of variance 0 stays where it is.
"""

from typing import NamedTuple

from valve_control.control.laws.projection import clip


class Weights(NamedTuple):
    """One number for each term of the compensation: weights, regressor, variances or bounds."""

    gain: float  # of u_r, the voltage of the inverted model
    bristle1: float  # of a bristle that the reference drags
    bristle2: float
    bristle3: float
    standstill: (
        float  # of the second bristle near standstill, where noise shakes it loose and Stribeck's part adds
    )
    flow: float  # of the reference, for the flow force
    offset: float  # of 1
    damping: float  # of the rate of the reference
    inertia: float  # of its acceleration


NOTHING = Weights(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def dot(a: Weights, b: Weights) -> float:
    """Scalar product."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3 + a4 * b4 + a5 * b5 + a6 * b6 + a7 * b7 + a8 * b8


def product(a: Weights, b: Weights) -> Weights:
    """Entry by entry."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return Weights(a0 * b0, a1 * b1, a2 * b2, a3 * b3, a4 * b4, a5 * b5, a6 * b6, a7 * b7, a8 * b8)


def lagged(x: Weights, towards: Weights, share: float) -> Weights:
    """First-order lag: ``x`` moved by ``share`` of the way ``towards`` its input."""
    x0, x1, x2, x3, x4, x5, x6, x7, x8 = x
    t0, t1, t2, t3, t4, t5, t6, t7, t8 = towards
    return Weights(
        x0 + share * (t0 - x0),
        x1 + share * (t1 - x1),
        x2 + share * (t2 - x2),
        x3 + share * (t3 - x3),
        x4 + share * (t4 - x4),
        x5 + share * (t5 - x5),
        x6 + share * (t6 - x6),
        x7 + share * (t7 - x7),
        x8 + share * (t8 - x8),
    )


def moved(theta: Weights, px: Weights, step: float, lower: Weights, upper: Weights) -> Weights:
    """Weights after a sample, θ - P·x·``step``, clipped into [``lower``, ``upper``]: (P1)."""
    w0, w1, w2, w3, w4, w5, w6, w7, w8 = theta
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = px
    l0, l1, l2, l3, l4, l5, l6, l7, l8 = lower
    u0, u1, u2, u3, u4, u5, u6, u7, u8 = upper
    return Weights(
        clip(w0 - g0 * step, l0, u0),
        clip(w1 - g1 * step, l1, u1),
        clip(w2 - g2 * step, l2, u2),
        clip(w3 - g3 * step, l3, u3),
        clip(w4 - g4 * step, l4, u4),
        clip(w5 - g5 * step, l5, u5),
        clip(w6 - g6 * step, l6, u6),
        clip(w7 - g7 * step, l7, u7),
        clip(w8 - g8 * step, l8, u8),
    )


def sharper(variance: float, px: float, sharpness: float, forget: float, prior: float) -> float:
    """Variance of one weight after a sample.

    ``px``: variance times regressor; ``sharpness``: 1/(noise² + xᵀ·P·x); the share ``forget`` of what is
    known is lost, so that the variance goes back towards ``prior``, that of the beginning, and never above.
    """
    left = variance - sharpness * px * px
    return left + forget * (prior - left)


def learned(variance: Weights, px: Weights, sharpness: float, forget: float, prior: Weights) -> Weights:
    """Variances of all weights after a sample."""
    v0, v1, v2, v3, v4, v5, v6, v7, v8 = variance
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = px
    q0, q1, q2, q3, q4, q5, q6, q7, q8 = prior
    return Weights(
        sharper(v0, g0, sharpness, forget, q0),
        sharper(v1, g1, sharpness, forget, q1),
        sharper(v2, g2, sharpness, forget, q2),
        sharper(v3, g3, sharpness, forget, q3),
        sharper(v4, g4, sharpness, forget, q4),
        sharper(v5, g5, sharpness, forget, q5),
        sharper(v6, g6, sharpness, forget, q6),
        sharper(v7, g7, sharpness, forget, q7),
        sharper(v8, g8, sharpness, forget, q8),
    )


def change(after: Weights, before: Weights, x: Weights) -> float:
    """(``after`` - ``before``)ᵀ·x."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = after
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = before
    x0, x1, x2, x3, x4, x5, x6, x7, x8 = x
    return (
        (a0 - b0) * x0
        + (a1 - b1) * x1
        + (a2 - b2) * x2
        + (a3 - b3) * x3
        + (a4 - b4) * x4
        + (a5 - b5) * x5
        + (a6 - b6) * x6
        + (a7 - b7) * x7
        + (a8 - b8) * x8
    )
