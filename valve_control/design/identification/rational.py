# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Fits rational transfer functions to a measured response, with confidence bounds.

scipy.signal has no invfreqs (scipy issue 4497), python-control no fit to a response (its issue 550), and the
vector fitting of scikit-rf leaves the number of zeros open. So: a start after Levy [1] in the iteration of
Sanathanan and Koerner [2], then maximum likelihood by scipy.optimize.least_squares.

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
SHORT_ROUNDS = 2  # ... and its rounds of model error; those of a fit are ...
ROUNDS_OF_ERROR = 4
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
    """A form of a model, and the response that it is fitted to; maps unbounded parameters to a stable one."""

    order: int
    zeros: int
    delayed: bool
    measured: Response
    scale: float  # rad/s
    gain: float  # V/V
    quick: bool  # whether the search only tells what the form is worth

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return self.order + self.zeros + 1 + self.delayed

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
        delay = float(x[-1]) * self.measured.period if self.delayed else 0.0
        return TransferFunction(tuple(map(float, numerator[::-1])), tuple(map(float, denominator))), delay

    def coefficients(self, x: Floats) -> Floats:
        """Numerator, denominator without its leading 1, and the delay if there is one."""
        model, delay = self.model(x)
        return np.array([*model.numerator, *model.denominator[1:], *([delay] if self.delayed else [])])

    def errors(self, x: Floats) -> Complexes:
        """What the model has beyond the measured response [V/V]."""
        model, delay = self.model(x)
        held = quick_held_response if self.quick else held_response
        return held(model, self.measured.frequency, self.measured.period, delay) - self.measured.value

    def residuals(self, x: Floats, weight: Floats) -> Floats:
        """Real and imaginary parts of the weighted errors."""
        error = self.errors(x) * weight
        return np.concatenate([error.real, error.imag])

    def model_error(self, x: Floats) -> float:
        """Relative error of the model that, added to the noise, makes the squared errors what they are."""
        distance, size = np.abs(self.errors(x)), np.abs(self.measured.value)
        free = max(1, 2 * len(size) - self.unknowns)

        def excess(part: float) -> float:
            variance = self.measured.deviation**2 + (part * size) ** 2
            return float(np.sum(distance**2 / variance)) - free

        # Twice the spread of the sum by chance alone.
        if excess(0.0) <= 2.0 * math.sqrt(2.0 * free):
            return 0.0
        high = 1e-9
        while excess(high) > 0.0 and high < 1e3:
            high *= 10.0
        return float(scipy.optimize.brentq(excess, 0.0, high, xtol=1e-12))

    def minimised(self, start: Floats, weight: Floats, latest: float) -> Floats:
        """The unknowns from ``start`` on that make the weighted errors least; dead time up to ``latest``."""
        tolerance, most = QUICK if self.quick else (1e-12, 100)
        low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
        low[: self.order], high[: self.order] = -WIDEST, WIDEST
        if self.delayed:
            widest = max(1.0, WIDEST_DELAY / (self.measured.frequency[0] * self.measured.period))
            low[-1], high[-1] = 0.0, min(widest, latest / self.measured.period)
        try:
            found = scipy.optimize.least_squares(
                self.residuals,
                np.clip(start, low + 1e-9, high - 1e-9),
                args=(weight,),
                bounds=(low, high),
                x_scale="jac",
                xtol=tolerance,
                ftol=tolerance,
                gtol=tolerance,
                max_nfev=most,
            )
        except (ValueError, np.linalg.LinAlgError) as error:
            raise ParameterError(f"no model of order {self.order} fits the response: {error}") from error
        best: Floats = found.x
        return best

    def searched(self, x: Floats, rounds: int, latest: float = math.inf) -> tuple[Floats, Floats]:
        """The unknowns from ``x`` on, and their weights: of the size, then ``rounds`` times of the variance.

        Raises ParameterError for a model that stands on the edge of stability or far outside the band.
        """
        size = np.abs(self.measured.value)
        weight = 1.0 / size
        x = self.minimised(x, weight, latest)
        for _ in range(rounds):
            weight = 1.0 / np.hypot(self.measured.deviation, self.model_error(x) * size)
            x = self.minimised(x, weight, latest)
        poles = np.roots(self.model(x)[0].denominator)
        hertz = np.abs(poles) / (2.0 * np.pi)
        damping = -poles.real / np.abs(poles)
        if np.min(damping) < LEAST_DAMPING:
            raise ParameterError(
                f"the fit of order {self.order} is unstable or on the edge of it (poles at "
                f"{hertz[np.argmin(damping)]:.4g} Hz without damping); choose another order or a better test"
            )
        low, high = float(self.measured.frequency[0]), float(self.measured.frequency[-1])
        for at in (float(np.min(hertz)), float(np.max(hertz))):
            if at < DEPTH * low or at > BAND * high:
                raise ParameterError(
                    f"the fit of order {self.order} puts a pole at {at:.4g} Hz, far outside the measured "
                    f"{low:.4g} to {high:.4g} Hz; choose a lower order"
                )
        return x, weight


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
    form, x, free_error = _start(measured, order, zeros, delayed, False)
    x, weight = form.searched(x, 0 if relative else ROUNDS_OF_ERROR, latest)
    size, model_error = np.abs(measured.value), form.model_error(x)
    error = float(np.sqrt(np.mean((np.abs(form.errors(x)) / size) ** 2)))
    if error > UNSTABLE * free_error:
        raise ParameterError(
            f"the fit of order {order} is unstable: poles to the right miss the response by "
            f"{100.0 * free_error:.2g} %, stable ones by {100.0 * error:.2g} %"
        )
    covariance = _covariance(form, x, weight, model_error)
    quantile = float(scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(1, 2 * len(size) - form.unknowns)))
    model, delay = form.model(x)
    names = [f"b{i}" for i in range(zeros, -1, -1)] + [f"a{i}" for i in range(order - 1, -1, -1)]
    gain_deviation = _deviations(lambda v: np.array([form.model(v)[0].static_gain]), x, covariance)
    return Fit(
        order=order,
        model=model,
        delay=delay,
        names=(*names, *(["delay"] if delayed else [])),
        values=form.coefficients(x),
        bounds=quantile * _deviations(form.coefficients, x, covariance),
        gain_bound=float(quantile * gain_deviation[0]),
        error=error,
        model_error=model_error,
        corners=model_corners(model, delay),
        bounded=model_error <= EXPLAINED or float(np.median(measured.deviation / size)) <= EXCITED,
    )


def criterion(measured: Response, order: int, zeros: int, delayed: bool) -> tuple[float, float]:
    """Schwarz's criterion of the form that ``fit`` gives, from a shorter search, and its model error.

    It is -2·(log likelihood) + (unknowns)·log(numbers measured), less is better. The variance at a frequency
    is that of the measurement and of the relative error of the model. Raises ParameterError.
    """
    form, x, _ = _start(measured, order, zeros, delayed, True)
    x, _ = form.searched(x, SHORT_ROUNDS)
    size, model_error = np.abs(measured.value), form.model_error(x)
    variance = measured.deviation**2 + (model_error * size) ** 2
    misfit = float(np.sum(2.0 * np.log(variance) + np.abs(form.errors(x)) ** 2 / variance))
    return misfit + form.unknowns * math.log(2 * len(size)), model_error


def _vaguest(made: Fit) -> tuple[str, float, float]:
    """Name, value and relative bound of the denominator's coefficient that is known worst."""
    share = made.bounds / np.maximum(np.abs(made.values), 1e-300)
    worst = max((i for i, name in enumerate(made.names) if name.startswith("a")), key=lambda i: share[i])
    return made.names[worst], float(made.values[worst]), float(share[worst])


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


def is_clear(made: Fit) -> bool:
    """Whether the data tell the order of a fit for which nobody asked: no zero cancels a pole of it, too."""
    poles, zeros = np.roots(made.model.denominator), np.roots(made.model.numerator)
    cancelled = np.any(np.abs(zeros - poles[:, None]) < CANCELLED * np.abs(poles[:, None]))
    return made.order == 2 or bool(not cancelled and made.bounded and _vaguest(made)[2] <= CLEAR)


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
        return np.asarray(np.exp(np.interp(at, known, size) + 1j * np.interp(at, known, turn)))

    return corners(evaluate, float(frequencies[-1]))


def hold(frequency: Floats, period: float) -> Complexes:
    """Response of the hold at ``frequency`` [Hz]: nearly half a period of delay."""
    turn = 2j * np.pi * frequency * period
    value: Complexes = -np.expm1(-turn) / turn
    return value


def _start(
    measured: Response, order: int, zeros: int, delayed: bool, quick: bool
) -> tuple[_Form, Floats, float]:
    """Linear least squares for each of several delays; the nearest is where the search begins.

    Last comes the relative error of what was found, if it has poles to the right, else infinity. Raises
    ParameterError if there are too few frequencies.
    """
    size, count = np.abs(measured.value), order + zeros + 1 + delayed
    if len(size) < count // 2 + 1:
        raise ParameterError(
            f"order {order} has {count} unknowns and needs {count // 2 + 1} frequencies; "
            f"{len(size)} could be measured"
        )
    value: Complexes = measured.value / hold(measured.frequency, measured.period)
    omega = 2.0 * np.pi * measured.frequency
    scale = float(np.sqrt(omega[0] * omega[-1]))
    delays = DELAY_STEP / measured.frequency[-1] * np.arange(DELAYS if delayed else 1)
    s = np.asarray(1j * omega / scale, dtype=np.complex128)
    tried = [
        (*_linear(value * np.exp(1j * omega * delay), s, order, zeros, size), float(delay))
        for delay in delays
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
    return _Form(order, zeros, delayed, measured, scale, gain, quick), x, unstable


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


def _deviations(read: Callable[[Floats], Floats], x: Floats, covariance: Floats) -> Floats:
    """Standard deviations of what ``read`` makes of the unknowns ``x``."""
    slope = _jacobian(read, x)
    variance = np.einsum("ij,jk,ik->i", slope, covariance, slope)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _jacobian(read: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Central differences; no parameter is far from 1."""
    columns = []
    for i, h in enumerate(1e-5 * np.maximum(0.1, np.abs(x))):
        step = np.where(np.arange(len(x)) == i, h, 0.0)
        columns.append((read(x + step) - read(x - step)) / (2.0 * h))
    return np.column_stack(columns)


def _covariance(form: _Form, x: Floats, weight: Floats, model_error: float) -> Floats:
    """Covariance of the parameters for any weight: (JᵀJ)⁻¹ JᵀΣJ (JᵀJ)⁻¹, Σ of noise and model error."""
    measured = form.measured
    if form.delayed:
        x = np.append(x[:-1], max(x[-1], 1e-4))
    deviation = np.hypot(measured.deviation, model_error * np.abs(measured.value)) * weight
    inverse = np.linalg.pinv(_jacobian(lambda v: form.residuals(v, weight), x))
    spread = inverse * np.concatenate([deviation, deviation])
    covariance: Floats = spread @ spread.T
    return covariance
