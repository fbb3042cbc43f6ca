# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Constants of dcarc, designed once: sampled model, its inverse, Kalman filter, LQR.

The derivation is in docs/explanation/laws/dcarc.md.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from valve_control.arrays import Floats
from valve_control.control.laws import dcarc_parts as parts
from valve_control.control.plant.transfer_functions import TransferFunction, slow_motion
from valve_control.control.plant.valve import observability_form
from valve_control.parameter import ParameterError

MOST_DELAY = 4  # sample periods
MOST_POLES = 6
EXCESS = (2, 3)  # more poles than zeros, as many as the reference has derivatives
DOUBLINGS = 50  # of the terms of a sum, at most; enough for poles at 1 - 1e-14
MOST_ZEROS = MOST_POLES - EXCESS[0]
SLOWEST_ZERO = (
    10.0  # 1/s  zeros of the model must decay at least as fast, since the inverse has them as poles
)
LEAST_DAMPING = 0.1  # -  of these zeros
LEAST_HUM = 40.0  # Hz  below it the observer would take motion for hum
FASTEST_ZERO = 1.5  # over the sample period, from which on a real zero is taken out of an identified model
HUM_WIDTH = 1.0  # Hz  on both sides of a hum's frequency, within which the observer takes it for hum


class Observed(NamedTuple):
    """What is observed: x⁺ = A·x + b·u + w, y = c·x + v, of model, disturbance and past positions."""

    a: Floats
    b: Floats
    c: Floats
    process: Floats  # covariance of w
    reading: float  # V²  variance of v


class Readings(NamedTuple):
    """What of ``Observed`` follows from the model and its dead time alone; not to be changed."""

    order: int  # of the model
    a: Floats
    b: Floats
    c: Floats


class Inverted(NamedTuple):
    """Rows of coefficients of (ζ, …, its highest inner derivative, r, ṙ, r̈, …), e = n - m derivatives."""

    rate: Floats  # of the inner states, m×(m + e + 1)
    voltage: Floats  # u_r
    state: Floats  # x_r, n×(m + e + 1)


def sampled(a: Floats, b: Floats, period: float, scale: Floats) -> tuple[Floats, Floats]:
    """A and b of x' = a·x + b·u over one ``period`` [s] with u held, exactly; ``scale``: sizes of x."""
    n = len(b)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = a * scale / scale[:, None], b / scale
    moved = scipy.linalg.expm(whole * period)
    return moved[:n, :n] / scale * scale[:, None], moved[:n, n] * scale


def excess(model: TransferFunction) -> int:
    """Poles less zeros."""
    poles, zeros = (
        len(np.trim_zeros(np.asarray(part), "f")) for part in (model.denominator, model.numerator)
    )
    return poles - zeros


def without_fast_zero(model: TransferFunction, period: float) -> TransferFunction:
    """``model`` without a real zero that samples of ``period`` [s] cannot invert, of the same static gain.

    In the middle of a period the inverse has the ζ̈ of a reference in a straight line, x/sinh(x) of the right
    one with x = z·ΔT/2. The highest derivative is then wrong by z·(1 - x/sinh(x))·ζ̈, which with a fast zero
    is more than the whole voltage. The lead of the zero, 1/z, is less than a period. A model that has three
    more poles than zeros already stays.
    """
    zeros = np.roots(np.asarray(model.numerator))
    if excess(model) >= EXCESS[1] or not len(zeros):
        return model
    fastest = zeros[np.argmax(np.abs(zeros))]
    if fastest.imag != 0.0 or abs(fastest) * period < FASTEST_ZERO:
        return model
    rest = np.polydiv(np.asarray(model.numerator), [1.0 / -fastest.real, 1.0])[0]
    return TransferFunction(tuple(rest.tolist()), model.denominator)


def _from_force(model: TransferFunction, coil: float) -> TransferFunction:
    """Position over a force that lags its voltage by ``coil`` [s]."""
    return TransferFunction(tuple(np.polymul(model.numerator, [coil, 1.0]).tolist()), model.denominator)


def balanced(model: TransferFunction) -> bool:
    """Whether the numbers of ``model`` need to be balanced before the matrix exponential.

    The models of order 2 to 4 with two fewer zeros do not.
    """
    n = len(observability_form(model)[1])
    return n > 4 or excess(model) > EXCESS[0]


def scale_of(model: TransferFunction) -> Floats:
    """Sizes of the states of the observability form: powers of a speed of the model's poles."""
    a, _ = observability_form(model)
    speeds = np.abs(np.linalg.eigvals(a))
    speed = float(np.max(speeds))
    if balanced(model):
        speed = float(np.exp(np.mean(np.log(np.maximum(speeds, 1.0)))))
    return np.array([max(speed, 1.0) ** i for i in range(len(a))])


def check(model: TransferFunction) -> None:
    """Raise ParameterError for a model that the law does not take, or that cannot be inverted."""
    numerator = np.trim_zeros(np.asarray(model.numerator, dtype=float), "f")
    denominator = np.trim_zeros(np.asarray(model.denominator, dtype=float), "f")
    order, zeros = len(denominator) - 1, len(numerator) - 1
    if not EXCESS[0] <= order <= MOST_POLES or order - zeros not in EXCESS:
        raise ParameterError(
            f"the model of dcarc has {order} poles and {zeros} zeros; it must have {EXCESS[0]} to "
            f"{MOST_POLES} poles and two or three fewer zeros, because the reference has up to three "
            "derivatives"
        )
    for zero in np.roots(numerator):
        if zero.real > -SLOWEST_ZERO or -zero.real < LEAST_DAMPING * abs(zero):
            where = f"{zero.real:.4g}" if zero.imag == 0.0 else f"{zero.real:.4g} ± {abs(zero.imag):.4g}j"
            raise ParameterError(
                f"the model of dcarc has a zero at {where} rad/s and cannot be inverted; zeros must lie "
                f"left of -{SLOWEST_ZERO:g} rad/s and have a damping ratio of at least {LEAST_DAMPING:g}"
            )


def inverted(model: TransferFunction) -> Inverted:
    """Inverse of ``model``: B(p)ζ = r, u_r = A(p)ζ, x_r the states of the observability form.

    Raises ParameterError for a model that cannot be inverted.
    """
    check(model)
    b = np.trim_zeros(np.asarray(model.numerator, dtype=float), "f")[::-1]
    a = np.trim_zeros(np.asarray(model.denominator, dtype=float), "f")[::-1]
    b, a = b / a[-1], a / a[-1]
    n, m = len(a) - 1, len(b) - 1
    rows = np.zeros((n + 1, n + 1))  # row j: the j-th derivative of ζ
    rows[:m, :m] = np.eye(m)
    for i in range(n - m + 1):
        rows[m + i, m + i] = 1.0
        rows[m + i] = (rows[m + i] - b[:m] @ rows[i : m + i]) / b[m]
    companion = np.diag(np.ones(n - 1), 1)
    companion[-1] = -a[:n]
    output = np.concatenate([b, np.zeros(n - m - 1)])
    form = np.array([output @ np.linalg.matrix_power(companion, i) for i in range(n)])
    return Inverted(rows[1 : m + 1], a @ rows, form @ rows[:n])


@functools.lru_cache(maxsize=32)
def readings(model: TransferFunction, period: float, delay: float, coil: float = 0.0) -> Readings:
    """Model, disturbance and past positions in samples of ``period`` [s].

    The reading y(k) is the position ``delay`` [s] before. With m = ⌈delay/period⌉, the first of m past
    positions is that between two samples at which a reading m - 1 samples later looks. The disturbance is a
    voltage, or a force that lags its voltage by ``coil`` [s].
    """
    a, b = observability_form(model)
    _, f = observability_form(_from_force(model, coil)) if coil > 0.0 else (a, b)
    n = len(b)
    periods = delay / period
    m = math.ceil(periods - 1e-9)
    size = n + 1 + m
    scale = scale_of(model) if balanced(model) else np.ones(n)
    transition, held = sampled(a, b, period, scale)
    pushed = sampled(a, f, period, scale)[1]
    whole, column, output = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    whole[:n, :n], whole[:n, n], whole[n, n] = transition, pushed, 1.0
    column[:n] = held
    output[n + m if m else 0] = 1.0
    if m:
        rest = (m - periods) * period
        within, part = sampled(a, b, rest, scale)
        whole[n + 1, :n], column[n + 1] = within[0], part[0]
        whole[n + 1, n] = sampled(a, f, rest, scale)[1][0]
        for i in range(n + 2, size):
            whole[i, i - 1] = 1.0
    return Readings(n, whole, column, output)


def observed(
    model: TransferFunction,
    period: float,
    delay: float,
    reading: float,
    input_noise: float,
    walk: float,
    coil: float = 0.0,
) -> Observed:
    """``readings`` with noise.

    ``reading`` [V] and ``input_noise`` [V]: standard deviations; ``walk`` [V]: of the disturbance's step in
    one period; ``coil`` [s]: lag of the force behind the voltage, 0.0 where both are one.
    """
    n, a, b, c = readings(model, period, delay, coil)
    shaken = np.concatenate([a[:n, n], [0.0], a[n + 1 :, n]])
    process = input_noise**2 * np.outer(shaken, shaken)
    process[n, n] += walk**2
    return Observed(a, b, c, process, reading**2)


def humming(o: Observed, gain: Floats, angle: float, period: float) -> Observed:
    """``o`` with a hum in its reading that turns by ``angle`` [rad] in one ``period`` [s].

    ``gain``: of the Kalman filter without it. Its innovation has the variance s = r/(1 - c·gain) and has the
    hum with the share |1/(1 + c(zI - A)⁻¹A·gain)|. The two states are shaken so that what is known of them
    decays at 2π·HUM_WIDTH.
    """
    size = len(o.a)
    a = np.zeros((size + 2, size + 2))
    a[:size, :size] = o.a
    a[size:, size:] = [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]
    innovation = o.reading / (1.0 - float(o.c @ gain))
    z = complex(math.cos(angle), math.sin(angle))
    shown = 1.0 / abs(1.0 + o.c @ np.linalg.solve(z * np.eye(size) - o.a, o.a @ gain))
    walk = 2.0 * innovation * (2.0 * math.pi * HUM_WIDTH * period / shown) ** 2
    return Observed(
        a,
        np.append(o.b, [0.0, 0.0]),
        np.append(o.c, [1.0, 0.0]),
        scipy.linalg.block_diag(o.process, walk * np.eye(2)),
        o.reading,
    )


def kalman(o: Observed, scale: Floats) -> Floats:
    """Gain of the steady-state Kalman filter, P·c/(c·P·c + R) with P of the Riccati equation.

    ``scale``: sizes of the states, which put the equation's numbers close to 1. Raises ParameterError.
    """
    a = o.a * scale / scale[:, None]
    c = (o.c * scale)[:, None]

    def solved(p: Floats) -> tuple[Floats, Floats]:
        gain = (p @ c)[:, 0] / ((c.T @ p @ c)[0, 0] + o.reading)
        return gain, a - np.outer(a @ gain, c[:, 0])

    advice = "; raise dcarc.disturbance_rate or dcarc.input_noise, or lower dcarc.lvdt_noise"
    equation = a.T, c, o.process / scale / scale[:, None], np.array([[o.reading]])
    return _stationary(equation, solved, "Kalman filter with these noises", advice) * scale


def regulator(a: Floats, b: Floats, weight: float, scale: Floats) -> Floats:
    """Gain K of the LQR that minimises Σ x_1² + ``weight``·u². Raises ParameterError."""
    a = a * scale / scale[:, None]
    b = (b / scale)[:, None]
    state = np.zeros(a.shape)
    state[0, 0] = 1.0

    def solved(s: Floats) -> tuple[Floats, Floats]:
        gain = (b.T @ s @ a)[0] / (weight + (b.T @ s @ b)[0, 0])
        return gain, a - b @ gain[None, :]

    what = f"LQR with dcarc.voltage_weight {weight:g}"
    return _stationary((a, b, state, np.array([[weight]])), solved, what, "") / scale


def _stationary(
    equation: tuple[Floats, ...], solved: Callable[[Floats], tuple[Floats, Floats]], what: str, advice: str
) -> Floats:
    """Gain that ``solved`` makes, with its closed loop, of the solution of the Riccati ``equation``."""
    try:
        gain, loop = solved(scipy.linalg.solve_discrete_are(*equation))
        radius = np.max(np.abs(np.linalg.eigvals(loop)))
    except (np.linalg.LinAlgError, ValueError) as error:
        reason = str(error).rstrip(".") or "the Riccati equation has no finite solution"
        raise ParameterError(f"dcarc has no {what}: {reason}") from error
    if not radius < 1.0:
        raise ParameterError(f"dcarc has no {what}: its largest pole would be {radius:.6f}{advice}")
    return gain


def mean_lag(o: Observed, gain: Floats, at: int) -> float:
    """Samples, at least 1, by which the estimate of ``at`` is late: sum of its errors after a step of 1."""
    correction = np.eye(len(gain)) - np.outer(gain, o.c)
    errors = correction @ np.linalg.inv(np.eye(len(gain)) - o.a @ correction)
    return float(errors[at, at])


def jitter(o: Observed, gain: Floats, feedback: Floats, scale: Floats, waves: int = 0) -> float:
    """Mean speed [V/s] at which the noise of the reading shakes the spool through ``feedback``.

    √(2/π) of the velocity's standard deviation on the model without friction, from the Lyapunov equation
    of model and observer in the loop. ``scale``: sizes of the observer's states; the last ``waves`` of them
    are of a hum. Raises ParameterError.
    """
    n, size = len(feedback), len(gain)
    own = [i for i in range(size - waves) if i != n]  # the model's states; its disturbance is none
    a, b, c = o.a * scale / scale[:, None], o.b / scale, o.c * scale
    gain = gain / scale
    k = np.concatenate([feedback, [1.0], np.zeros(size - n - 1)]) * scale
    moved, corrected = a - np.outer(b, k), np.eye(size) - np.outer(gain, c)
    whole = np.block(
        [
            [a[np.ix_(own, own)] - (k @ gain) * np.outer(b[own], c[own]), -np.outer(b[own], k @ corrected)],
            [np.outer(moved @ gain, c[own]), moved @ corrected],
        ]
    )
    shaken = np.concatenate([-(k @ gain) * b[own], moved @ gain])
    covariance = o.reading * np.outer(shaken, shaken)
    with np.errstate(all="ignore"):
        for _ in range(DOUBLINGS):  # Σ of wholeⁱ·Q·wholeⁱᵀ, twice as many terms each time (Smith 1968)
            before, covariance = covariance, covariance + whole @ covariance @ whole.T
            if np.array_equal(before, covariance):
                break
            whole = whole @ whole
    variance = float(covariance[1, 1])
    if not math.isfinite(variance):
        raise ParameterError("dcarc has no finite response to the noise of the LVDT with these weights")
    return math.sqrt(2.0 / math.pi * max(variance, 0.0)) * float(scale[1])


def _filled(kind: Any, numbers: Floats) -> Any:
    """Record of a ``kind`` of numbers, of which the last ones may be missing: 0.0."""
    return kind(*numbers.tolist(), *[0.0] * (len(kind._fields) - len(numbers)))


def _combination(row: Floats, zeros: int) -> parts.Combination:
    """``row`` of coefficients as in ``Inverted``, of a model with so many ``zeros``."""
    inner = np.concatenate([row[:zeros], np.zeros(MOST_ZEROS - zeros)])
    reference = np.concatenate([row[zeros:], np.zeros(EXCESS[1] + 1 - len(row) + zeros)])
    return parts.Combination(*(float(v) for v in (*inner, *reference)))


def _move(rate: Floats, time: float) -> parts.Move:
    """Inner states after ``time`` [s] with a reference that moves in a straight line, exactly."""
    m = len(rate)
    whole = np.zeros((m + 2, m + 2))
    whole[:m, : m + 1] = rate[:, : m + 1]
    whole[m, m + 1] = 1.0
    rows = np.zeros((MOST_ZEROS, MOST_ZEROS + 2))
    after = scipy.linalg.expm(whole * time)[:m]
    rows[:m, :m], rows[:m, MOST_ZEROS:] = after[:, :m], after[:, m:]
    return parts.Move(*(_filled(parts.Row, row) for row in rows))


def _rest(of: Inverted, reference: float, rate: float) -> parts.Rest:
    """Steady motion through ``reference`` [V] at ``rate`` [V/s]."""
    m = len(of.rate)
    inner = np.zeros(m, dtype=np.float64)
    if m:
        # ζ = p + q·t in ζ' = a·ζ + b·r with r = reference + rate·t: a·q + b·rate = 0, a·p + b·reference = q.
        q = np.linalg.solve(of.rate[:, :m], -of.rate[:, m] * rate)
        inner[:] = np.linalg.solve(of.rate[:, :m], q - of.rate[:, m] * reference)
    whole = np.concatenate([inner, [reference, rate], np.zeros(of.voltage.size - m - 2)])
    return parts.Rest(
        _filled(parts.Row, of.state @ whole), _filled(parts.Inverse, inner), float(of.voltage @ whole)
    )


@functools.lru_cache(maxsize=32)
def reference(model: TransferFunction, period: float) -> tuple[Inverted, dict[str, Any]]:
    """Inverse of ``model``, and how it moves in one ``period`` [s]: fields of ``dcarc.Params``.

    Raises ParameterError.
    """
    of = inverted(model)
    return of, dict(
        full=_move(of.rate, period),
        half=_move(of.rate, 0.5 * period),
        model_voltage=_combination(of.voltage, len(of.rate)),
        standing=_rest(of, 1.0, 0.0),
        moving=_rest(of, 0.0, 1.0),
    )


def waiting(model: TransferFunction, period: float, coil: float, dead_time: float, age: float) -> Any:
    """Dead time of the actuator [s]: a voltage acts so much later than it is sent, for one ``period``.

    ``age`` [s]: of the first of the past positions, at the next sample; see ``readings`` for ``coil``.
    Returns whole periods; the column of the voltage that acts at the end of a period, and its part of that
    position; the same of the one before, which acts at its beginning; the transition over the dead time, what
    voltages before (n×MOST_DELAY) do until the one of now begins to act, and what the disturbance does.
    """
    a, b = observability_form(model)
    _, f = observability_form(_from_force(model, coil)) if coil > 0.0 else (a, b)
    scale = scale_of(model)
    periods = math.floor(dead_time / period + 1e-9)
    begin = max(dead_time - periods * period, 0.0)  # of the later voltage within a period
    whole, full = sampled(a, b, period, scale)
    until, before = sampled(a, b, begin, scale)
    after, then = sampled(a, b, period - begin, scale)
    seen = period - age  # within a period
    if seen > begin:
        rest, last = sampled(a, b, seen - begin, scale)
        first = rest @ before
    else:
        last, first = np.zeros(len(b)), sampled(a, b, seen, scale)[1]
    held = np.zeros((len(b), MOST_DELAY + 1))
    power = np.eye(len(b))
    for i in range(periods):
        held[:, i] = power @ full
        power = whole @ power
    held[:, periods] = power @ before
    over = power @ until, held[:, :MOST_DELAY], sampled(a, f, dead_time, scale)[1]
    return periods, (then, float(last[0])), (after @ before, float(first[0])), over


@functools.lru_cache(maxsize=32)
def equivalent(model: TransferFunction) -> parts.Equivalent:
    """Second-order model with the static gain and the two slowest poles of ``model``.

    Where one of these is half of a pair, that of its slow motion, if there is one.
    """
    poles = np.roots(model.denominator)
    slow = poles[np.argsort(np.abs(poles))[:2]]
    own = slow_motion(model) if np.sum(slow).imag != 0.0 else None
    if own is not None:
        return parts.Equivalent(*own)
    a1, a0 = float(-np.sum(slow).real), float(np.prod(np.abs(slow)))
    return parts.Equivalent(a1, a0, a0 * model.static_gain)


def _refuse(
    model: TransferFunction, period: float, delay: float, coil: float, dead_time: float, hum: float
) -> None:
    """Raise ParameterError for numbers that do not fit each other."""
    if coil > 0.0 and excess(model) <= EXCESS[0]:
        raise ParameterError(
            f"dcarc.coil is {coil:g} s; the model must then have three more poles than zeros, or dcarc.coil "
            "must be 0"
        )
    for name, time in (("delay", delay), ("actuator_delay", dead_time)):
        if time > MOST_DELAY * period * (1.0 + 1e-9):
            raise ParameterError(
                f"dcarc.{name} is {time:g} s; at a sample period of {period:g} s it must be at most "
                f"{MOST_DELAY * period:g} s"
            )
    if 0.0 < hum < LEAST_HUM:
        raise ParameterError(
            f"dcarc.hum is {hum:g} Hz; it must be 0 or at least {LEAST_HUM:g} Hz, so that motion is not "
            "taken for hum"
        )
    if hum >= 0.5 / period:
        raise ParameterError(
            f"dcarc.hum is {hum:g} Hz; it must lie below half of the sample rate, {0.5 / period:g} Hz"
        )


@functools.lru_cache(maxsize=32)
def design(
    model: TransferFunction,
    period: float,
    delay: float,
    noise: float,
    resolution: float,
    input_noise: float,
    disturbance_rate: float,
    voltage_weight: float,
    coil: float,
    dead_time: float,
    hum: float = 0.0,
) -> dict[str, Any]:
    """Fields of ``dcarc.Params`` for ``model`` at ``period`` [s], with a reading ``delay`` [s] late.

    ``noise`` and ``resolution`` [V]: of the LVDT; ``input_noise`` [V], ``disturbance_rate`` [V/√s]: what the
    Kalman filter assumes of the input; ``voltage_weight``: of LQR; ``coil`` [s]: lag of the force behind the
    voltage; ``dead_time`` [s]: of the actuator; ``hum`` [Hz]: in the reading, 0.0: none.

    Raises ParameterError.
    """
    of, moves = reference(model, period)
    _refuse(model, period, delay, coil, dead_time, hum)
    n = readings(model, period, delay).order
    reading = math.sqrt(noise**2 + resolution**2 / 12.0)
    o = observed(model, period, delay, reading, input_noise, disturbance_rate * math.sqrt(period), coil)
    m = len(o.a) - n - 1
    sizes = scale_of(model)
    scale = np.concatenate([sizes, [1.0], np.ones(m)])
    gain = kalman(o, scale)
    angle, waves = 2.0 * math.pi * hum * period, 2 if hum > 0.0 else 0
    wave = np.zeros(2)
    if waves:
        o, scale = humming(o, gain, angle, period), np.append(scale, [1.0, 1.0])
        gain = kalman(o, scale)
        wave = gain[-waves:]
    transition, held = o.a[:n, :n], o.b[:n]
    feedback = regulator(transition, held, voltage_weight, sizes)
    ages = np.array([delay - (m - i) * period for i in range(1, m + 1)])
    shown = np.array([0.0] * (m - 1) + [1.0] * min(m, 1))
    full = np.zeros((MOST_POLES, n))
    full[:n] = transition
    rows = [_filled(parts.Row, row) for row in full]
    passing = o.a[n + 1, :n] if m else np.zeros(n)
    whole, later, (early, passing_early), over = waiting(
        model, period, coil, dead_time, ages[0] if m else 0.0
    )
    until, waits, pushed = over
    acting, late = later if dead_time > 0.0 else (held, float(o.b[n + 1]) if m else 0.0)
    return dict(
        model=parts.Model(
            row0=rows[0],
            row1=rows[1],
            row2=rows[2],
            row3=rows[3],
            row4=rows[4],
            row5=rows[5],
            input=_filled(parts.Row, acting),
            force=_filled(parts.Row, o.a[:n, n] - acting),
            passing=_filled(parts.Row, passing),
            passing_input=late if m else 0.0,
            passing_force=float(o.a[n + 1, n]) - late if m else 0.0,
            waits=1.0 if dead_time > 0.0 else 0.0,
            direct=1.0 if whole == 0 else 0.0,
            acting=_filled(parts.Past, np.eye(MOST_DELAY + 1)[whole][1:]),
            leaving=_filled(parts.Past, np.eye(MOST_DELAY + 2)[whole + 1][1 : MOST_DELAY + 1]),
            early=_filled(parts.Row, early),
            passing_early=passing_early if m else 0.0,
            present=0.0 if m else 1.0,
            shown=_filled(parts.Past, shown),
            ages=_filled(parts.Past, ages),
        ),
        kalman=parts.KalmanGains(
            _filled(parts.Row, gain[:n]),
            float(gain[n]),
            _filled(parts.Past, gain[n + 1 : n + 1 + m]),
            parts.Wave(float(wave[0]), float(wave[1])),
        ),
        turn=parts.Turn(1.0 if waves else 0.0, math.cos(angle), math.sin(angle)),
        feedback=_filled(parts.Row, feedback @ until if dead_time > 0.0 else feedback),
        waiting=_filled(parts.Past, feedback @ waits),
        unexplained=float(feedback @ pushed),
        wanted=_combination(feedback @ of.state, len(of.rate)),
        **moves,
        lag_share=1.0 / mean_lag(o, gain, n),
        jitter=jitter(o, gain, feedback, scale, waves),
        equivalent=equivalent(model),
    )
