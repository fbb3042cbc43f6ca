# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the design of dcarc hands to the law: a sampled model, its inverse and gains, as pure numbers."""

from typing import NamedTuple


class Row(NamedTuple):
    """Six numbers: row of the transition matrix, input column, gains, or state; unused ones are 0.0."""

    x0: float
    x1: float
    x2: float
    x3: float
    x4: float
    x5: float


class Past(NamedTuple):
    """Positions on their way to the reading, or voltages to the valve, the newest first, or their factors."""

    first: float
    second: float
    third: float
    fourth: float


class Inverse(NamedTuple):
    """Inner states of the inverted model: ζ and its derivatives, 0.0 where the model has fewer zeros."""

    zeta: float
    rate: float
    accel: float
    jerk: float


class Move(NamedTuple):
    """Inner states some time later while the reference moves in a straight line: of them, it and its rate."""

    zeta: Row
    rate: Row
    accel: Row
    jerk: Row


class Combination(NamedTuple):
    """Coefficients of the inner states, and of the reference with its derivatives."""

    zeta: float
    rate: float
    accel: float
    jerk: float
    reference: float
    reference_rate: float
    reference_accel: float
    reference_jerk: float  # 0.0 with two more poles than zeros


class Model(NamedTuple):
    """Sampled model of the valve with the dead time of its LVDT."""

    row0: Row
    row1: Row
    row2: Row
    row3: Row
    row4: Row
    row5: Row
    input: Row
    force: Row  # column of a disturbance at the force, less that of the voltage; 0.0 without a coil
    passing: Row  # position within the period that is the first of the past ones
    passing_input: float
    passing_force: float
    waits: float  # 1.0 if the voltage acts later than it is sent
    direct: float  # 1.0 if the voltage of now acts at the end of the period
    acting: Past  # 1.0 at the voltage before that acts there
    leaving: Past  # 1.0 at the voltage before that acts at its beginning
    early: Row  # column of the latter
    passing_early: float
    present: float  # 1.0 if the reading shows the present position
    shown: Past  # 1.0 at the past position that the reading shows
    ages: Past  # s  of the past positions


class Wave(NamedTuple):
    """Hum of the mains in the reading, as it turns, or the gains of both numbers."""

    shown: float  # V  part of the reading
    ahead: float  # V  the same a quarter of a period later


class Turn(NamedTuple):
    """By how much the hum turns in one sample period."""

    on: float  # 1.0 if there is a hum to be looked for
    cosine: float  # -
    sine: float  # -


class KalmanGains(NamedTuple):
    """Gains of the Kalman filter."""

    state: Row
    disturbance: float
    past: Past
    hum: Wave


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
    a0, a1, a2, a3, a4, a5 = row
    x0, x1, x2, x3, x4, x5 = x
    return a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3 + a4 * x4 + a5 * x5


def scaled(x: Row, factor: float) -> Row:
    """``x`` times ``factor``."""
    x0, x1, x2, x3, x4, x5 = x
    return Row(x0 * factor, x1 * factor, x2 * factor, x3 * factor, x4 * factor, x5 * factor)


def plus(x: Row, g: Row, factor: float) -> Row:
    """``x`` and ``factor`` times ``g``, entry by entry."""
    x0, x1, x2, x3, x4, x5 = x
    g0, g1, g2, g3, g4, g5 = g
    return Row(
        x0 + g0 * factor,
        x1 + g1 * factor,
        x2 + g2 * factor,
        x3 + g3 * factor,
        x4 + g4 * factor,
        x5 + g5 * factor,
    )


def past_plus(x: Past, g: Past, factor: float) -> Past:
    """``x`` and ``factor`` times ``g``, entry by entry."""
    x0, x1, x2, x3 = x
    g0, g1, g2, g3 = g
    return Past(x0 + g0 * factor, x1 + g1 * factor, x2 + g2 * factor, x3 + g3 * factor)


def times(m: Model, x: Row) -> Row:
    """Transition matrix of ``m`` times ``x``."""
    return Row(dot(m.row0, x), dot(m.row1, x), dot(m.row2, x), dot(m.row3, x), dot(m.row4, x), dot(m.row5, x))


def past_dot(a: Past, b: Past) -> float:
    """Scalar product."""
    a0, a1, a2, a3 = a
    b0, b1, b2, b3 = b
    return a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3


def turned(turn: Turn, wave: Wave) -> Wave:
    """``wave`` one sample period later."""
    return Wave(
        turn.cosine * wave.shown + turn.sine * wave.ahead, turn.cosine * wave.ahead - turn.sine * wave.shown
    )


class Course(NamedTuple):
    """The reference at one time, with its derivatives."""

    reference: float  # V
    rate: float  # V/s
    accel: float  # V/s²
    jerk: float  # V/s³


def combined(c: Combination, s: Inverse, r: Course) -> float:
    """Linear combination ``c`` of inner states and reference."""
    c0, c1, c2, c3, c4, c5, c6, c7 = c
    s0, s1, s2, s3 = s
    r0, r1, r2, r3 = r
    return c0 * s0 + c1 * s1 + c2 * s2 + c3 * s3 + c4 * r0 + c5 * r1 + c6 * r2 + c7 * r3


def moved(m: Move, s: Inverse, reference: float, rate: float) -> Inverse:
    """Inner states of the inverse after ``m``, from ``reference`` [V] and ``rate`` [V/s] before."""
    x = Row(s.zeta, s.rate, s.accel, s.jerk, reference, rate)
    return Inverse(dot(m.zeta, x), dot(m.rate, x), dot(m.accel, x), dot(m.jerk, x))
