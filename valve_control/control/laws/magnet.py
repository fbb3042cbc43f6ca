# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What a magnet adds to the compensation of dcarc: direction of the force, and its positive part.

The force lags the voltage by the coil, dF/dt = (u - F)/τ_c. A magnet with hysteresis holds its force until
the voltage has passed a play of the half width h: the voltage for a force is F + h·sign(dF/dt). A bristle
that the force drags along stands for the sign. Two solenoids of unequal gains need another voltage on one
side: a share of the positive part of the force (docs/explanation/laws/dcarc.md).
"""

from typing import NamedTuple


class Pair(NamedTuple):
    """One number for each of the two terms: weights, regressor, variances or bounds."""

    direction: float  # V    of the direction of the force
    positive: float  # -    of the positive part of the force


NONE = Pair(0.0, 0.0)


class Params(NamedTuple):
    """Constants of the terms."""

    on: float  # 1.0 if one of them is in use
    coil: float  # s    τ_c
    lead: float  # -    τ_c over the sample period
    turn: float  # V    way of the force over which its direction turns
    initial: Pair
    lower: Pair
    upper: Pair
    prior: Pair  # variances of the initial weights


class State(NamedTuple):
    """The force that the reference asks for, and what is learned."""

    force: float  # V    of the inverted model alone, in the middle of the period before
    rate: float  # V/s
    total: float  # V    with the compensation
    direction: float  # -    -1 to 1
    weights: Pair
    regressor: Pair  # as late as the estimated disturbance
    variance: Pair  # of the weights


class Terms(NamedTuple):
    """Regressors of a sample."""

    total: float  # V
    direction: float  # -
    force: Pair  # at the force
    voltage: Pair  # at the voltage, led by the coil


def dot(a: Pair, b: Pair) -> float:
    """Scalar product."""
    return a.direction * b.direction + a.positive * b.positive


def product(a: Pair, b: Pair) -> Pair:
    """Entry by entry."""
    return Pair(a.direction * b.direction, a.positive * b.positive)


def change(after: Pair, before: Pair, x: Pair) -> float:
    """(``after`` - ``before``)ᵀ·x."""
    direction, positive = after.direction - before.direction, after.positive - before.positive
    return direction * x.direction + positive * x.positive


def lagged(x: Pair, towards: Pair, share: float) -> Pair:
    """First-order lag: ``x`` moved by ``share`` of the way ``towards`` its input."""
    return Pair(
        x.direction + share * (towards.direction - x.direction),
        x.positive + share * (towards.positive - x.positive),
    )


def forced(p: Params, s: State, voltage: float, period: float) -> tuple[float, float]:
    """Force [V] that ``voltage`` [V] of the middle of a ``period`` [s] leads to there, and its rate [V/s].

    The coil by the trapezoidal rule from the middle of the period before.
    """
    if p.coil > 0.0:
        half = 0.5 * period / p.coil
        force = (s.force + 0.5 * period * s.rate + half * voltage) / (1.0 + half)
        return force, (voltage - force) / p.coil
    return voltage, (voltage - s.force) / period


def terms(p: Params, s: State, total: float, led: float) -> Terms:
    """Regressors from the ``total`` force [V] with its compensation, and the voltage ``led`` [V] for it."""
    way = (total - s.total) / p.turn
    direction = (s.direction + way) / (1.0 + abs(way))
    voltage = direction + p.lead * (direction - s.direction)
    if total > 0.0:
        return Terms(total, direction, Pair(direction, total), Pair(voltage, led))
    return Terms(total, direction, Pair(direction, 0.0), Pair(voltage, 0.0))
