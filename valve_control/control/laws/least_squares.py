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
    return (
        a.gain * b.gain
        + a.bristle1 * b.bristle1
        + a.bristle2 * b.bristle2
        + a.bristle3 * b.bristle3
        + a.standstill * b.standstill
        + a.flow * b.flow
        + a.offset * b.offset
        + a.damping * b.damping
        + a.inertia * b.inertia
    )


def product(a: Weights, b: Weights) -> Weights:
    """Entry by entry."""
    return Weights(
        a.gain * b.gain,
        a.bristle1 * b.bristle1,
        a.bristle2 * b.bristle2,
        a.bristle3 * b.bristle3,
        a.standstill * b.standstill,
        a.flow * b.flow,
        a.offset * b.offset,
        a.damping * b.damping,
        a.inertia * b.inertia,
    )


def lagged(x: Weights, towards: Weights, share: float) -> Weights:
    """First-order lag: ``x`` moved by ``share`` of the way ``towards`` its input."""
    return Weights(
        x.gain + share * (towards.gain - x.gain),
        x.bristle1 + share * (towards.bristle1 - x.bristle1),
        x.bristle2 + share * (towards.bristle2 - x.bristle2),
        x.bristle3 + share * (towards.bristle3 - x.bristle3),
        x.standstill + share * (towards.standstill - x.standstill),
        x.flow + share * (towards.flow - x.flow),
        x.offset + share * (towards.offset - x.offset),
        x.damping + share * (towards.damping - x.damping),
        x.inertia + share * (towards.inertia - x.inertia),
    )


def moved(theta: Weights, px: Weights, step: float, lower: Weights, upper: Weights) -> Weights:
    """Weights after a sample, θ - P·x·``step``, clipped into [``lower``, ``upper``]: (P1)."""
    return Weights(
        clip(theta.gain - px.gain * step, lower.gain, upper.gain),
        clip(theta.bristle1 - px.bristle1 * step, lower.bristle1, upper.bristle1),
        clip(theta.bristle2 - px.bristle2 * step, lower.bristle2, upper.bristle2),
        clip(theta.bristle3 - px.bristle3 * step, lower.bristle3, upper.bristle3),
        clip(theta.standstill - px.standstill * step, lower.standstill, upper.standstill),
        clip(theta.flow - px.flow * step, lower.flow, upper.flow),
        clip(theta.offset - px.offset * step, lower.offset, upper.offset),
        clip(theta.damping - px.damping * step, lower.damping, upper.damping),
        clip(theta.inertia - px.inertia * step, lower.inertia, upper.inertia),
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
    return Weights(
        sharper(variance.gain, px.gain, sharpness, forget, prior.gain),
        sharper(variance.bristle1, px.bristle1, sharpness, forget, prior.bristle1),
        sharper(variance.bristle2, px.bristle2, sharpness, forget, prior.bristle2),
        sharper(variance.bristle3, px.bristle3, sharpness, forget, prior.bristle3),
        sharper(variance.standstill, px.standstill, sharpness, forget, prior.standstill),
        sharper(variance.flow, px.flow, sharpness, forget, prior.flow),
        sharper(variance.offset, px.offset, sharpness, forget, prior.offset),
        sharper(variance.damping, px.damping, sharpness, forget, prior.damping),
        sharper(variance.inertia, px.inertia, sharpness, forget, prior.inertia),
    )


def change(after: Weights, before: Weights, x: Weights) -> float:
    """(``after`` - ``before``)ᵀ·x."""
    return (
        (after.gain - before.gain) * x.gain
        + (after.bristle1 - before.bristle1) * x.bristle1
        + (after.bristle2 - before.bristle2) * x.bristle2
        + (after.bristle3 - before.bristle3) * x.bristle3
        + (after.standstill - before.standstill) * x.standstill
        + (after.flow - before.flow) * x.flow
        + (after.offset - before.offset) * x.offset
        + (after.damping - before.damping) * x.damping
        + (after.inertia - before.inertia) * x.inertia
    )
