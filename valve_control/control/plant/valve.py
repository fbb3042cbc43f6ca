# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates one sample of the valve as a pure step: linear model, input disturbances, amplifier, LVDT.

The linear part is the observability form of its transfer function, whose first two states are spool
position and velocity, discretised exactly for a voltage that is held over the period. Friction and flow
force enter as the input disturbance d of (1).
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.control.plant.saturation import saturate
from valve_control.control.plant.sensor import Lvdt, reading
from valve_control.control.plant.transfer_functions import TransferFunction


class Row(NamedTuple):
    """Four numbers: a row of the transition matrix, the input column, or the state."""

    x0: float
    x1: float
    x2: float
    x3: float


class Disturbance(NamedTuple):
    """Friction, flow force and drift, all as voltages at the valve's input."""

    coulomb: float  # V      Coulomb friction
    static_ratio: float  # -      static over Coulomb friction, at least 1
    stribeck_velocity: float  # V/s    decay of the static part
    velocity_scale: float  # V/s    half-width of the linear zone around standstill, without presliding
    presliding: float  # V      deflection of the bristles before the spool slides, 0: none
    flow_force: float  # V/V    d = -flow_force·x
    offset: float  # V      constant part, b0·dn / b0
    stiffness_drift: float  # V/V/s  growth of an additional flow_force
    gain_drift: float  # 1/s    relative growth of the gain


NO_DISTURBANCE = Disturbance(0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Params(NamedTuple):
    """One valve at one sample period."""

    row0: Row
    row1: Row
    row2: Row
    row3: Row
    input: Row
    gain_scale: float  # -  multiplies the model's gain
    u_max: float  # V  limit of the amplifier
    period: float  # s  ΔT
    disturbance: Disturbance
    lvdt: Lvdt


class State(NamedTuple):
    """State of valve and LVDT. ``history`` is a ring of past samples and is overwritten in place.

    Each of its rows holds a position [V], and where a third of a period at the velocity of then leads to [V].
    """

    x: Row  # position [V], velocity [V/s] and two inner states
    bristle: float  # -  deflection of the bristles over that of sliding, -1 to 1
    time: float  # s
    history: npt.NDArray[np.float64]  # V, (samples, 2)
    newest: int  # index into history


class ModelError(ValueError):
    """Says why a transfer function cannot be that of a valve."""


def realisation(
    model: TransferFunction,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Matrices A (n×n) and B (n) of the observability form: x = (position, velocity, …), C = e1ᵀ.

    Raises ModelError unless the order is 2 to 4 and the relative degree at least 2 (a voltage must not
    make the velocity jump, or friction would have no meaning).
    """
    denominator = np.trim_zeros(np.asarray(model.denominator, dtype=float), "f")
    numerator = np.trim_zeros(np.asarray(model.numerator, dtype=float), "f")
    n = len(denominator) - 1
    if not 2 <= n <= 4 or not 1 <= len(numerator) <= n - 1:
        raise ModelError(
            f"a valve model has order 2 to 4 and at least two more poles than zeros; "
            f"this one has {n} poles and {len(numerator) - 1} zeros"
        )
    return observability_form(model)


def observability_form(
    model: TransferFunction,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """``realisation`` of a model of any order with more poles than zeros."""
    denominator = np.trim_zeros(np.asarray(model.denominator, dtype=float), "f")
    numerator = np.trim_zeros(np.asarray(model.numerator, dtype=float), "f")
    n = len(denominator) - 1
    a = denominator[1:] / denominator[0]
    c = np.concatenate([np.zeros(n - len(numerator)), numerator / denominator[0]])
    markov = np.zeros(n)
    for i in range(n):
        markov[i] = c[i] - a[:i] @ markov[:i][::-1]
    companion = np.diag(np.ones(n - 1), 1)
    companion[-1] = -a[::-1]
    return companion, markov


def design(
    model: TransferFunction,
    period: float,
    u_max: float,
    gain_scale: float,
    disturbance: Disturbance,
    lvdt: Lvdt,
) -> Params:
    """Valve with ``model``, discretised exactly at ``period`` [s]."""
    import scipy.linalg  # takes a while

    a, b = realisation(model)
    n = len(b)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n] = a
    augmented[:n, n] = b
    transition = scipy.linalg.expm(augmented * period)
    full = np.zeros((4, 5))
    full[:n, :n] = transition[:n, :n]
    full[:n, 4] = transition[:n, n]
    rows = [Row(*(float(v) for v in row[:4])) for row in full]
    column = Row(*(float(v) for v in full[:, 4]))
    row0, row1, row2, row3 = rows
    return Params(
        row0=row0,
        row1=row1,
        row2=row2,
        row3=row3,
        input=column,
        gain_scale=gain_scale,
        u_max=u_max,
        period=period,
        disturbance=disturbance,
        lvdt=lvdt,
    )


def initial(p: Params) -> State:
    """Spool at rest in the centre, no voltage."""
    length = int(p.lvdt.delay) + 2
    return State(Row(0.0, 0.0, 0.0, 0.0), 0.0, 0.0, np.zeros((length, 2)), 0)


def standing(p: Params, position: float, voltage: float) -> State:
    """Spool at rest at ``position`` [V] under ``voltage`` [V], where friction holds it as far as it can."""
    d, state = p.disturbance, initial(p)
    transition = np.array([p.row0, p.row1, p.row2, p.row3])
    try:
        at_rest = np.linalg.solve(np.eye(4) - transition, np.array(p.input))
    except np.linalg.LinAlgError:  # a valve without a spring rests anywhere
        at_rest = np.zeros(4)
    if at_rest[0] == 0.0:
        return state
    u = position / float(at_rest[0])
    bristle = 0.0
    if d.coulomb > 0.0 and d.presliding > 0.0:
        rubbing = saturate(voltage, p.u_max) + d.offset - d.flow_force * position - u / p.gain_scale
        bristle = saturate(rubbing / friction_level(d, 0.0), 1.0)
    state.history[:] = position
    return state._replace(x=Row(position, 0.0, u * float(at_rest[2]), u * float(at_rest[3])), bristle=bristle)


def remember(history: npt.NDArray[np.float64], newest: int, x: Row, period: float) -> None:
    """Put the position and velocity of ``x`` in row ``newest`` of ``history`` (as of ``State``)."""
    history[newest, 0] = x.x0
    history[newest, 1] = x.x0 + x.x1 * period / 3.0


def delayed(delay: float, history: npt.NDArray[np.float64], newest: int) -> float:
    """Position [V] ``delay`` periods before the ``newest`` row of ``history`` (as of ``State``).

    Between two samples it is the cubic (in Bézier's form) through both positions with both velocities; a
    straight line would be a low-pass of its own.
    """
    whole = int(delay)
    part = delay - whole
    n = len(history)
    later = (newest - whole) % n
    earlier = (newest - whole - 1) % n
    p0, p1 = float(history[earlier, 0]), float(history[earlier, 1])
    p3 = float(history[later, 0])
    p2 = 2.0 * p3 - float(history[later, 1])
    t = 1.0 - part
    return part * part * (part * p0 + 3.0 * t * p1) + t * t * (3.0 * part * p2 + t * p3)


def read(p: Params, s: State, noise: float) -> float:
    """LVDT reading [V] at this sample; ``noise`` is a standard normal number."""
    position = s.x.x0
    if p.lvdt.delay > 0.0:
        position = delayed(p.lvdt.delay, s.history, s.newest)
    return reading(p.lvdt, position, noise)


def dot(row: Row, x: Row) -> float:
    """Scalar product."""
    return row.x0 * x.x0 + row.x1 * x.x1 + row.x2 * x.x2 + row.x3 * x.x3


def friction_level(d: Disturbance, velocity: float) -> float:
    """Level of friction [V]: Coulomb's with Stribeck's addition at the present ``velocity`` [V/s].

    From eight Stribeck velocities on the addition is below the last bit of Coulomb's part, and not computed.
    """
    if d.static_ratio > 1.0 and abs(velocity) < 8.0 * d.stribeck_velocity:
        ratio = velocity / d.stribeck_velocity
        return d.coulomb * (1.0 + (d.static_ratio - 1.0) * math.exp(-ratio * ratio))
    return d.coulomb


def friction(
    d: Disturbance, level: float, bristle: float, free_velocity: float, mobility: float, period: float
) -> tuple[float, float]:
    """Friction voltage over the next ``period`` [s] and the bristles' deflection after it, both implicit.

    ``level`` [V]: of ``friction_level``. The rest acts on the velocity that it leads to,
    v = ``free_velocity`` - ``mobility``·friction (``mobility`` in V/s per V), for which both shapes have a
    closed solution: the spool sticks without chatter at any period, and friction never exceeds its level.

    presliding = 0: level·clip(v/velocity_scale, -1, 1). Else level·z, where the bristles' deflection obeys
    dz/dt = (v - |v|·z)/presliding: below its level friction is a spring of level/presliding, so small
    motions show hysteresis (Dahl 1968; LuGre of Canudas de Wit et al. 1995 with stiffness 1/presliding and
    without bristle damping).
    """
    # Each division serves both shapes: a batch would wait for those of both, whichever a valve has.
    bristles = d.presliding > 0.0
    above, below = (period, d.presliding) if bristles else (level, d.velocity_scale)
    a = above / below
    # Backward Euler: z⁺·(1 + a·|v|) = z + a·v. The difference that moves the spool gives the sign of v.
    moving = free_velocity - mobility * level * bristle
    sign = math.copysign(1.0, moving)
    b = 1.0 + a * (mobility * level - sign * free_velocity)
    root = math.sqrt(b * b + 4.0 * a * abs(moving))
    above, below = (2.0 * abs(moving), b + root) if b > 0.0 else (root - b, 2.0 * a)
    speed = above / below
    above, below = (
        (bristle + a * sign * speed, 1.0 + a * speed) if bristles else (a * free_velocity, 1.0 + mobility * a)
    )
    ratio = above / below
    if bristles:
        return level * ratio, ratio
    return max(-level, min(level, ratio)), 0.0


def move(p: Params, x: Row, bristle: float, time: float, level: float, voltage: float) -> tuple[Row, float]:
    """Linear states and bristles one period later, with ``voltage`` [V] held over it from ``time`` [s] on.

    ``level`` [V]: of friction, at the velocity of ``x``.
    """
    d = p.disturbance
    force = saturate(voltage, p.u_max) + d.offset - (d.flow_force + d.stiffness_drift * time) * x.x0
    gain = p.gain_scale * max(0.0, 1.0 + d.gain_drift * time)
    v_free = dot(p.row1, x) + p.input.x1 * gain * force
    if d.coulomb > 0.0:
        rubbing, bristle = friction(d, level, bristle, v_free, p.input.x1 * gain, p.period)
        force -= rubbing
    u = gain * force
    following = Row(
        dot(p.row0, x) + p.input.x0 * u,
        dot(p.row1, x) + p.input.x1 * u,
        dot(p.row2, x) + p.input.x2 * u,
        dot(p.row3, x) + p.input.x3 * u,
    )
    return following, bristle


def step(p: Params, s: State, voltage: float) -> State:
    """State of the valve one period later, with ``voltage`` [V] held over it."""
    level = 0.0
    if p.disturbance.coulomb > 0.0:
        level = friction_level(p.disturbance, s.x.x1)
    following, bristle = move(p, s.x, s.bristle, s.time, level, voltage)
    newest = s.newest
    if p.lvdt.delay > 0.0:
        newest = (newest + 1) % len(s.history)
        remember(s.history, newest, following, p.period)
    return State(following, bristle, s.time + p.period, s.history, newest)
