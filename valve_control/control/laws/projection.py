# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps the estimates inside their bounds: discontinuous projection (14)-(16)."""

from typing import NamedTuple


class Theta(NamedTuple):
    """Plant parameters of (4) and (17), or four numbers that belong to them (rates, bounds, regressors)."""

    a1: float  # 1/s   theta_1
    a0: float  # 1/s²  theta_2
    b0: float  # 1/s²  theta_3
    b0dn: float  # V/s²  theta_4 = b0*d_n


def projected_rate(estimate: float, rate: float, lower: float, upper: float) -> float:
    """Rate of one estimate after the mapping (14): 0 where it would leave [lower, upper]."""
    if estimate >= upper and rate > 0.0:
        return 0.0
    if estimate <= lower and rate < 0.0:
        return 0.0
    return rate


def clip(estimate: float, lower: float, upper: float) -> float:
    """Estimate limited to [lower, upper]: property (P1) for a step of finite length."""
    if estimate > upper:
        return upper
    if estimate < lower:
        return lower
    return estimate


def rates(theta: Theta, gamma: Theta, tau: Theta, lower: Theta, upper: Theta) -> Theta:
    """Adaptation law (15): Proj(Γτ), entry by entry."""
    return Theta(
        projected_rate(theta.a1, gamma.a1 * tau.a1, lower.a1, upper.a1),
        projected_rate(theta.a0, gamma.a0 * tau.a0, lower.a0, upper.a0),
        projected_rate(theta.b0, gamma.b0 * tau.b0, lower.b0, upper.b0),
        projected_rate(theta.b0dn, gamma.b0dn * tau.b0dn, lower.b0dn, upper.b0dn),
    )


def advance(theta: Theta, rate: Theta, period: float, lower: Theta, upper: Theta) -> Theta:
    """Estimates one ``period`` [s] later: Euler step, then clipped into the bounds (P1)."""
    return Theta(
        clip(theta.a1 + rate.a1 * period, lower.a1, upper.a1),
        clip(theta.a0 + rate.a0 * period, lower.a0, upper.a0),
        clip(theta.b0 + rate.b0 * period, lower.b0, upper.b0),
        clip(theta.b0dn + rate.b0dn * period, lower.b0dn, upper.b0dn),
    )


def span(lower: Theta, upper: Theta) -> Theta:
    """Widths θmax - θmin of the assumed ranges (5)."""
    return Theta(upper.a1 - lower.a1, upper.a0 - lower.a0, upper.b0 - lower.b0, upper.b0dn - lower.b0dn)


def uncertainty(span: Theta, regressor: Theta, disturbance_bound: float) -> float:
    """Bound h on |θ̃ᵀφ| + |d̃| over the box of width ``span`` = θmax - θmin.

    Sum of |θimax - θimin|*|φi| instead of the usual ‖θmax - θmin‖*‖φ‖: it bounds the same quantity and,
    by Cauchy-Schwarz, is never larger, so that the robust term is no stronger than it has to be.
    """
    return (
        span.a1 * abs(regressor.a1)
        + span.a0 * abs(regressor.a0)
        + span.b0 * abs(regressor.b0)
        + span.b0dn * abs(regressor.b0dn)
        + disturbance_bound
    )
