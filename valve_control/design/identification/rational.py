# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Fits rational transfer functions to a measured response, with confidence bounds.

No library that the package could lean on fits a continuous transfer function to a response: scipy.signal has
no invfreqs (scipy issue 4497 is open), python-control has none either (its issue 550 points to SLICOT's
SB10YD, which wants Fortran through slycot and gives a state-space model without uncertainty), and scikit-rf's
vector fitting leaves the number of zeros open. So: a start after Levy [1] in the iteration of Sanathanan and
Koerner [2], then maximum likelihood by scipy.optimize.least_squares.

[1] E. C. Levy, Complex-curve fitting, IRE Trans. Automatic Control 4 (1959).
[2] C. K. Sanathanan, J. Koerner, Transfer function synthesis as a ratio of two complex polynomials, IEEE
    Trans. Automatic Control 8 (1963).
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.stats

from valve_control.arrays import Complexes, Floats
from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification.bode import (
    LOWEST,
    Corners,
    corners,
    held_response,
    model_corners,
    quick_held_response,
)
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError

CONFIDENCE = 0.95
VAGUE = 0.5  # of the static gain, a bound beyond which a fit says nothing
CANCELLED = 0.02  # of a pole, a distance of a zero from it that no test's frequencies show
UNKNOWN = 1.0  # of a denominator's coefficient, a bound beyond which the order is not in the data
CLEAR = 0.3  # of a denominator's coefficient, a bound up to which an order is chosen unasked
EXPLAINED = 0.1  # relative error that noise does not explain up to which bounds hold ...
EXCITED = 0.02  # ... or usual relative uncertainty of a test that tells the response well
MISSED = 0.5  # of the response, rms, likewise
UNSURE = 0.1  # relative uncertainty from which on a frequency tells nothing of a corner
UNSTABLE = 3.0  # times the error of unstable poles that stable ones may have
ROUNDS = 30  # of the start's iteration
QUICK = (1e-6, 60)  # tolerance and evaluations of a search that tells whether a form is worth more ...
SHORT_ROUNDS = 2  # ... and its rounds of model error
LEAST_DAMPING = 1e-3
DELAYS = 40  # tried to begin with, each a tenth of the fastest cycle more
DELAY_STEP = 0.1
WIDEST_DELAY = 0.25  # of the slowest cycle
BAND = 20.0  # times the highest measured frequency below which a pole is believed
WIDEST = 14.0  # logarithm of a factor's coefficient over the scale
DEPTH = 0.2  # times the lowest one above which it is


class Fit(NamedTuple):
    """A fitted model of the valve with its uncertainty."""

    order: int
    model: TransferFunction  # highest denominator coefficient 1
    delay: float  # s
    names: tuple[str, ...]  # of the coefficients: b2, b1, b0, a3, …, a0, delay
    values: Floats  # of the coefficients
    bounds: Floats  # half-widths of their 95 % confidence intervals
    gain_bound: float  # V/V, of the static gain
    error: float  # rms of the relative error
    model_error: float  # relative error that the noise does not explain
    corners: Corners
    bounded: bool = True  # whether the test tells the bounds


class _Form(NamedTuple):
    """Maps unbounded parameters to the coefficients of a stable model."""

    order: int
    zeros: int
    delayed: bool
    scale: float  # rad/s
    gain: float  # V/V
    period: float  # s
    latest: float  # s  upper bound of the dead time

    def model(self, x: Floats) -> tuple[TransferFunction, float]:
        """Model and delay [s]; the denominator is made of factors with positive coefficients."""
        w = self.scale
        denominator: npt.NDArray[Any] = np.ones(1)
        for i in range(self.order // 2):
            denominator = np.polymul(
                denominator, [1.0, w * math.exp(x[2 * i]), w**2 * math.exp(x[2 * i + 1])]
            )
        if self.order % 2:
            denominator = np.polymul(denominator, [1.0, w * math.exp(x[self.order - 1])])
        ascending = x[self.order : self.order + self.zeros + 1] * self.gain
        numerator = denominator[-1] * ascending * w ** -np.arange(self.zeros + 1.0)
        delay = float(x[-1]) * self.period if self.delayed else 0.0
        return (
            TransferFunction(tuple(map(float, numerator[::-1])), tuple(map(float, denominator))),
            delay,
        )

    def coefficients(self, x: Floats) -> Floats:
        """Numerator, denominator without its leading 1, and the delay if there is one."""
        model, delay = self.model(x)
        return np.array([*model.numerator, *model.denominator[1:], *([delay] if self.delayed else [])])


def fit(
    measured: Response,
    order: int,
    zeros: int | None = None,
    delayed: bool = False,
    relative: bool = False,
    latest: float = math.inf,
) -> Fit:
    """Stable model of ``order`` with ``zeros`` (two fewer than poles) that comes nearest to ``measured``.

    One unit of error is the standard deviation of the measurement, with a relative error of the model added
    where noise alone does not explain the distance; ``relative``: the size of the response. The model is
    compared as held and sampled, so that hold and sampling bias nothing. ``delayed``: a dead time is
    estimated too, of ``latest`` [s] at most. Bounds come from the Jacobian. Raises ParameterError if there
    are too few frequencies, or no model fits.
    """
    zeros = max(0, order - 2) if zeros is None else zeros
    if not 0 <= zeros < order:
        raise ParameterError(f"a model of order {order} has 0 to {order - 1} zeros, not {zeros}")
    count = order + zeros + 1 + delayed
    needed = count // 2 + 1
    if len(measured.frequency) < needed:
        raise ParameterError(
            f"order {order} has {count} unknowns and needs {needed} frequencies; "
            f"{len(measured.frequency)} could be measured"
        )
    size = np.abs(measured.value)
    form, x, free_error = _start(measured, order, zeros, delayed, size, latest)
    x, weight = _weighted(form, x, measured, relative, count)
    _check(form, x, measured)
    distance = _distance(form, x, measured)
    model_error = _model_error(measured, distance, count)
    error = float(np.sqrt(np.mean((distance / size) ** 2)))
    if error > UNSTABLE * free_error:
        raise ParameterError(
            f"the fit of order {order} is unstable: poles to the right miss the response by "
            f"{100.0 * free_error:.2g} %, stable ones by {100.0 * error:.2g} %"
        )
    covariance = _covariance(form, x, measured, weight, model_error)
    free = max(1, 2 * len(size) - count)
    quantile = float(scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, free))
    model, delay = form.model(x)
    names = [f"b{i}" for i in range(zeros, -1, -1)] + [f"a{i}" for i in range(order - 1, -1, -1)]
    return Fit(
        order=order,
        model=model,
        delay=delay,
        names=(*names, *(["delay"] if delayed else [])),
        values=form.coefficients(x),
        bounds=quantile * _deviations(form.coefficients, x, covariance),
        gain_bound=float(
            quantile * _deviations(lambda v: np.array([form.model(v)[0].static_gain]), x, covariance)[0]
        ),
        error=error,
        model_error=model_error,
        corners=model_corners(model, delay),
        bounded=model_error <= EXPLAINED or float(np.median(measured.deviation / size)) <= EXCITED,
    )


def _deviations(read: Callable[[Floats], Floats], x: Floats, covariance: Floats) -> Floats:
    """Standard deviations of what ``read`` makes of the unknowns ``x``."""
    slope = _jacobian(read, x)
    variance = np.einsum("ij,jk,ik->i", slope, covariance, slope)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _weighted(
    form: _Form, x: Floats, measured: Response, relative: bool, count: int
) -> tuple[Floats, Floats]:
    """The ``count`` unknowns from ``x`` on, and the weights used; ``relative``: as of ``fit``."""
    size = np.abs(measured.value)
    weight = 1.0 / size
    x = _minimise(form, x, measured, weight)
    if relative:
        return x, weight
    for _ in range(4):
        model_error = _model_error(measured, _distance(form, x, measured), count)
        weight = 1.0 / np.hypot(measured.deviation, model_error * size)
        x = _minimise(form, x, measured, weight)
    return x, weight


def criterion(measured: Response, order: int, zeros: int, delayed: bool) -> tuple[float, float]:
    """Schwarz's criterion of the form that ``fit`` gives, from a shorter search, and its model error.

    It is -2·(log likelihood) + (unknowns)·log(numbers measured), less is better. The variance at a frequency
    is that of the measurement and of the relative error of the model. Raises ParameterError.
    """
    size = np.abs(measured.value)
    count = order + zeros + 1 + delayed
    if len(size) < count // 2 + 1:
        raise ParameterError(f"order {order} has {count} unknowns, and {len(size)} frequencies were measured")
    form, x, _ = _start(measured, order, zeros, delayed, size, math.inf)
    x = _minimise(form, x, measured, 1.0 / size, True)
    for _ in range(SHORT_ROUNDS):
        model_error = _model_error(measured, np.abs(_errors(form, x, measured, True)), count)
        x = _minimise(form, x, measured, 1.0 / np.hypot(measured.deviation, model_error * size), True)
    _check(form, x, measured)
    distance = np.abs(_errors(form, x, measured, True))
    model_error = _model_error(measured, distance, count)
    variance = measured.deviation**2 + (model_error * size) ** 2
    misfit = float(np.sum(2.0 * np.log(variance) + distance**2 / variance))
    return misfit + count * math.log(2 * len(size)), model_error


def check_worth(made: Fit) -> None:
    """Raise ParameterError for a fit that says nothing about the valve."""
    gain = made.model.static_gain
    if not made.error <= MISSED:
        raise ParameterError(
            f"order {made.order} misses the response by {100.0 * made.error:.2g} % rms and says nothing of "
            "the valve (--order, --delay, --band or a better test)"
        )
    if made.order > 2:
        # Coefficients of a stable denominator are positive: one that may as well be 0 is not in the data.
        name, value, share = _vaguest(made)
        if not share <= UNKNOWN:
            raise ParameterError(
                f"the data do not support order {made.order}: its {name} is "
                f"{value:.3g} ± {100.0 * share:.2g} %; choose a lower order (--order 2)"
            )
    if not made.gain_bound <= VAGUE * abs(gain):
        raise ParameterError(
            f"order {made.order} leaves the static gain open, {gain:.3g} ± {made.gain_bound:.2g} V/V; "
            "test at lower frequencies, longer, or with a larger amplitude"
        )


def _cancelled(model: TransferFunction) -> float | None:
    """Frequency [Hz] of a pole of ``model`` that one of its zeros cancels; None: there is none."""
    zeros = np.roots(model.numerator)
    for pole in np.roots(model.denominator):
        if np.any(np.abs(zeros - pole) < CANCELLED * abs(pole)):
            return float(abs(pole)) / (2.0 * math.pi)
    return None


def _vaguest(made: Fit) -> tuple[str, float, float]:
    """Name, value and relative bound of the denominator's coefficient that is known worst."""
    share = made.bounds / np.maximum(np.abs(made.values), 1e-300)
    worst = max((i for i, name in enumerate(made.names) if name.startswith("a")), key=lambda i: share[i])
    return made.names[worst], float(made.values[worst]), float(share[worst])


def check_clear(made: Fit) -> None:
    """Raise ParameterError for a fit of an order for which nobody asked and which the data do not tell."""
    at = _cancelled(made.model)
    if at is not None:
        raise ParameterError(
            f"a zero at {at:.4g} Hz cancels a pole of order {made.order} there; --order {made.order} takes "
            "it all the same"
        )
    name, value, share = _vaguest(made)
    if not made.bounded:
        raise ParameterError(
            f"order {made.order} still misses the response by {100.0 * made.model_error:.2g} % that is not "
            f"noise; --order {made.order} takes it all the same"
        )
    if not share <= CLEAR:
        raise ParameterError(
            f"the data do not tell order {made.order} well: its {name} is {value:.3g} ± "
            f"{100.0 * share:.2g} %; --order {made.order} takes it all the same"
        )


def measured_corners(measured: Response, static_gain: float) -> Corners:
    """-3 dB below ``static_gain`` [V/V] and -90° of the response itself, read between its frequencies.

    The hold's half sample is taken off, so that they compare with those of a continuous model.
    """
    sure = measured.deviation < UNSURE * np.abs(measured.value)
    if np.count_nonzero(sure) < 2:
        return Corners(None, None)
    frequencies = measured.frequency[sure]
    value = measured.value[sure] / hold(frequencies, measured.period)
    turn = np.unwrap(np.angle(value * math.copysign(1.0, value[0].real)))
    # Far below the lowest frequency the phase is 0.
    known = np.log(np.append(min(LOWEST, 0.1 * frequencies[0]), frequencies))
    turn = np.append(0.0, turn)
    size = np.log(np.abs(np.append(static_gain, value)))

    def evaluate(frequency: Floats) -> Complexes:
        at = np.log(frequency)
        made: Complexes = np.exp(np.interp(at, known, size) + 1j * np.interp(at, known, turn))
        return made

    return corners(evaluate, float(frequencies[-1]))


def hold(frequency: Floats, period: float) -> Complexes:
    """Response of the hold at ``frequency`` [Hz]: nearly half a period of delay."""
    turn = 2j * np.pi * frequency * period
    value: Complexes = -np.expm1(-turn) / turn
    return value


def _start(
    measured: Response, order: int, zeros: int, delayed: bool, size: Floats, latest: float
) -> tuple[_Form, Floats, float]:
    """Linear least squares for each of several delays; the nearest is where the search begins.

    Last comes the relative error of what was found, if it has poles to the right, else infinity.
    """
    value: Complexes = measured.value / hold(measured.frequency, measured.period)
    omega = 2.0 * np.pi * measured.frequency
    scale = float(np.sqrt(omega[0] * omega[-1]))
    delays = DELAY_STEP / measured.frequency[-1] * np.arange(DELAYS if delayed else 1)
    s = np.asarray(1j * omega / scale, dtype=np.complex128)
    advanced = [value * np.exp(1j * omega * delay) for delay in delays]
    tried = [
        (*_linear(without, s, order, zeros, size), float(delay))
        for without, delay in zip(advanced, delays, strict=True)
    ]
    error, numerator, below, delay = min(tried, key=lambda attempt: attempt[0])
    poles = np.asarray(np.roots(below[::-1]), dtype=np.complex128)
    factors = _stable_factors(poles, order)
    gain = float(abs(value[0])) or 1.0
    static = float(np.prod(np.exp(factors[1 : order - order % 2 : 2])))
    static *= float(np.exp(factors[-1])) if order % 2 else 1.0
    at = [max(0.05, delay / measured.period)] if delayed else []
    x = np.concatenate([factors, numerator / (static * gain), at])
    unstable = math.sqrt(error / len(size)) if np.any(poles.real > 0.0) else math.inf
    return _Form(order, zeros, delayed, scale, gain, measured.period, latest), x, unstable


def _linear(
    value: Complexes, s: Complexes, order: int, zeros: int, size: Floats
) -> tuple[float, Floats, Floats]:
    """Error, numerator and denominator (lowest power first) that make numerator - value·denominator small.

    Each round weighs by the denominator of the one before, so that what is made small becomes the distance.
    """
    powers = s[:, None] ** np.arange(max(order, zeros) + 1)
    weight = 1.0 / size
    best: tuple[float, Floats, Floats] | None = None
    for _ in range(ROUNDS):
        left = np.hstack([powers[:, : zeros + 1], -value[:, None] * powers[:, :order]]) * weight[:, None]
        right = value * powers[:, order] * weight
        solution, _, _, _ = np.linalg.lstsq(
            np.vstack([left.real, left.imag]), np.concatenate([right.real, right.imag]), rcond=None
        )
        numerator, below = solution[: zeros + 1], np.append(solution[zeros + 1 :], 1.0)
        denominator = powers[:, : order + 1] @ below
        error = float(np.sum((np.abs(powers[:, : zeros + 1] @ numerator / denominator - value) / size) ** 2))
        if best is None or error < best[0]:
            best = (error, numerator, below)
        weight = 1.0 / (size * np.maximum(np.abs(denominator), 1e-9))
    assert best is not None
    return best


def _stable_factors(poles: Complexes, order: int) -> Floats:
    """Logarithms of the factors' coefficients; what lies to the right is mirrored to the left."""
    left = -np.maximum(np.abs(poles.real), 1e-3 * np.abs(poles)) + 1j * poles.imag
    pairs = [p for p in left if p.imag > 1e-12 * abs(p)]
    real = sorted((-p.real for p in left if abs(p.imag) <= 1e-12 * abs(p)), reverse=True)
    factors = [(2.0 * -p.real, abs(p) ** 2) for p in pairs]
    while len(real) >= 2:
        first, second = real.pop(), real.pop()
        factors.append((first + second, first * second))
    made = [math.log(c) for pair in sorted(factors, key=lambda pair: pair[1]) for c in pair]
    return np.array(made + [math.log(p) for p in real[: order % 2]])


def _distance(form: _Form, x: Floats, measured: Response) -> Floats:
    return np.abs(_errors(form, x, measured))


def _errors(form: _Form, x: Floats, measured: Response, quick: bool = False) -> Complexes:
    model, delay = form.model(x)
    held = quick_held_response if quick else held_response
    return held(model, measured.frequency, form.period, delay) - measured.value


def _residuals(form: _Form, x: Floats, measured: Response, weight: Floats, quick: bool = False) -> Floats:
    error = _errors(form, x, measured, quick) * weight
    return np.concatenate([error.real, error.imag])


def _minimise(form: _Form, start: Floats, measured: Response, weight: Floats, quick: bool = False) -> Floats:
    tolerance, most = QUICK if quick else (1e-12, 100)
    low = np.full(len(start), -np.inf)
    high = np.full(len(start), np.inf)
    low[: form.order], high[: form.order] = -WIDEST, WIDEST
    if form.delayed:
        widest = max(1.0, WIDEST_DELAY / (measured.frequency[0] * form.period))
        low[-1], high[-1] = 0.0, min(widest, form.latest / form.period)
    inside = np.clip(start, low + 1e-9, high - 1e-9)
    try:
        found = scipy.optimize.least_squares(
            lambda x: _residuals(form, x, measured, weight, quick),
            inside,
            bounds=(low, high),
            x_scale="jac",
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
            max_nfev=most,
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ParameterError(f"no model of order {form.order} fits the response: {error}") from error
    best: Floats = found.x
    return best


def _model_error(measured: Response, distance: Floats, count: int) -> float:
    """Relative error of the model that, added to the noise, makes the squared distances what they are."""
    size = np.abs(measured.value)
    free = max(1, 2 * len(size) - count)

    def excess(part: float) -> float:
        return float(np.sum(distance**2 / (measured.deviation**2 + (part * size) ** 2))) - free

    # Twice the spread of the sum by chance alone.
    if excess(0.0) <= 2.0 * math.sqrt(2.0 * free):
        return 0.0
    high = 1e-9
    while excess(high) > 0.0 and high < 1e3:
        high *= 10.0
    return float(scipy.optimize.brentq(excess, 0.0, high, xtol=1e-12))


def _jacobian(read: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Central differences; no parameter is far from 1."""
    columns = []
    for i in range(len(x)):
        h = 1e-5 * max(0.1, abs(x[i]))
        above, below = x.copy(), x.copy()
        above[i] += h
        below[i] -= h
        columns.append((read(above) - read(below)) / (2.0 * h))
    return np.column_stack(columns)


def _covariance(form: _Form, x: Floats, measured: Response, weight: Floats, model_error: float) -> Floats:
    """Covariance of the parameters for any weight: (JᵀJ)⁻¹ JᵀΣJ (JᵀJ)⁻¹, Σ of noise and model error."""
    if form.delayed:
        x = np.append(x[:-1], max(x[-1], 1e-4))
    jacobian = _jacobian(lambda v: _residuals(form, v, measured, weight), x)
    deviation = np.hypot(measured.deviation, model_error * np.abs(measured.value)) * weight
    inverse = np.linalg.pinv(jacobian)
    spread = inverse * np.concatenate([deviation, deviation])
    covariance: Floats = spread @ spread.T
    return covariance


def _check(form: _Form, x: Floats, measured: Response) -> None:
    """Raise ParameterError for a model that stands on the edge of stability or far outside the band."""
    model, _ = form.model(x)
    poles = np.roots(model.denominator)
    damping = -poles.real / np.abs(poles)
    if np.min(damping) < LEAST_DAMPING:
        at = float(np.abs(poles[np.argmin(damping)])) / (2.0 * np.pi)
        raise ParameterError(
            f"the fit of order {form.order} is unstable or on the edge of it (poles at {at:.4g} Hz without "
            "damping); choose another order or a better test"
        )
    slowest = float(np.min(np.abs(poles))) / (2.0 * np.pi)
    if slowest < DEPTH * measured.frequency[0]:
        raise ParameterError(
            f"the fit of order {form.order} puts a pole at {slowest:.2g} Hz, far below the measured "
            f"{measured.frequency[0]:.4g} Hz; choose a lower order"
        )
    widest = float(np.max(np.abs(poles))) / (2.0 * np.pi)
    if widest > BAND * measured.frequency[-1]:
        raise ParameterError(
            f"the fit of order {form.order} puts a pole at {widest:.4g} Hz, far above the measured "
            f"{measured.frequency[-1]:.4g} Hz; choose a lower order"
        )
