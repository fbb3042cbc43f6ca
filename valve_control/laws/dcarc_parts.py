"""What the design of dcarc hands to the law: a sampled model, its inverse and gains, as pure numbers."""

from typing import NamedTuple


class Row(NamedTuple):
    """Four numbers: row of the transition matrix, input column, gains, or state; unused ones are 0.0."""

    x0: float
    x1: float
    x2: float
    x3: float


class Past(NamedTuple):
    """Positions on their way to the reading, the newest first, or a number for each of them."""

    first: float
    second: float
    third: float
    fourth: float


class Inverse(NamedTuple):
    """Inner states of the inverted model: ζ and its rate, 0.0 where the model has fewer zeros."""

    zeta: float
    rate: float


class Move(NamedTuple):
    """What leads to the inner states some time later while the reference moves in a straight line."""

    zeta: Inverse  # of ζ
    rate: Inverse  # of its rate
    reference: Inverse  # of the reference [V]
    reference_rate: Inverse  # of its rate [V/s]


class Combination(NamedTuple):
    """Coefficients of the inner states, and of the reference with its derivatives."""

    zeta: float
    rate: float
    reference: float
    reference_rate: float
    reference_accel: float


class Model(NamedTuple):
    """Sampled model of the valve with the dead time of its LVDT."""

    row0: Row
    row1: Row
    row2: Row
    row3: Row
    input: Row
    passing: Row  # position within the period that is the first of the past ones
    passing_input: float
    present: float  # 1.0 if the reading shows the present position
    shown: Past  # 1.0 at the past position that the reading shows
    ages: Past  # s  of the past positions


class Gains(NamedTuple):
    """Gains of the Kalman filter."""

    state: Row
    disturbance: float
    past: Past


class Rest(NamedTuple):
    """The model in steady motion, for each 1 V of position or each 1 V/s of velocity."""

    state: Row
    inverse: Inverse
    voltage: float  # V


class Equivalent(NamedTuple):
    """Second-order model of the same slow behaviour."""

    a1: float  # 1/s
    a0: float  # 1/s²
    b0: float  # 1/s²


def dot(row: Row, x: Row) -> float:
    """Scalar product."""
    return row.x0 * x.x0 + row.x1 * x.x1 + row.x2 * x.x2 + row.x3 * x.x3


def past_dot(a: Past, b: Past) -> float:
    """Scalar product."""
    return a.first * b.first + a.second * b.second + a.third * b.third + a.fourth * b.fourth


def combined(c: Combination, s: Inverse, reference: float, rate: float, accel: float) -> float:
    """Linear combination ``c`` of inner states, reference [V] and its derivatives [V/s, V/s²]."""
    return (
        c.zeta * s.zeta
        + c.rate * s.rate
        + c.reference * reference
        + c.reference_rate * rate
        + c.reference_accel * accel
    )


def moved(m: Move, s: Inverse, reference: float, rate: float) -> Inverse:
    """Inner states of the inverse after ``m``, from ``reference`` [V] and ``rate`` [V/s] before."""
    a, b, c, d = m
    return Inverse(
        a.zeta * s.zeta + b.zeta * s.rate + c.zeta * reference + d.zeta * rate,
        a.rate * s.zeta + b.rate * s.rate + c.rate * reference + d.rate * rate,
    )
