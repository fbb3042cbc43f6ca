# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Fits transfer functions to a measured frequency response, with bounds, and chooses their form.

scipy.signal has no invfreqs (scipy issue 4497), python-control no fit to a response (its issue 550), and the
vector fitting of scikit-rf leaves the number of zeros open. So: a start after Levy [1] in the iteration of
Sanathanan and Koerner [2], then maximum likelihood by scipy.optimize.least_squares.

[1] E. C. Levy, Complex-curve fitting, IRE Trans. Automatic Control 4 (1959).
[2] C. K. Sanathanan, J. Koerner, Transfer function synthesis as a ratio of two complex polynomials, IEEE
    Trans. Automatic Control 8 (1963).
[3] G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978).
"""

import math
from itertools import groupby
from typing import NamedTuple

import numpy as np
import scipy.optimize
import scipy.stats

from valve_control.arrays import Complexes, Floats
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.identification.bode import Corners, held_response, model_corners
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
UNSTABLE = 3.0  # times the error of unstable poles that stable ones may have
WIDEST = 14.0  # logarithm of a factor's coefficient over the scale
ROUNDS = 30  # of the start's iteration
ROUNDS_OF_ERROR = 4
LEAST_DAMPING = 1e-3
DELAYS = 40  # tried to begin with, each a tenth of the fastest cycle more
DELAY_STEP = 0.1
WIDEST_DELAY = 0.25  # of the slowest cycle
BAND = 20.0  # times the highest measured frequency below which a pole is believed
DEPTH = 0.2  # times the lowest one above which it is
FORMS = ((2, 0), (3, 0), (3, 1), (4, 1), (4, 2))  # poles and zeros
NEAR = 6.0  # of the criterion, within which the simplest candidate counts


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
    criterion: float = math.inf  # Schwarz's [3]: -2·(log likelihood) + (unknowns)·log(numbers measured)


class _Form(NamedTuple):
    """A form of a model, and the response that it is fitted to."""

    zeros: int
    delayed: bool
    measured: Response
    units: Floats  # of the unknowns: numerator, denominator without its leading 1, dead time

    def model(self, x: Floats) -> tuple[TransferFunction, float]:
        """Model and delay [s]."""
        values = (x * self.units).tolist()
        delay = values.pop() if self.delayed else 0.0
        return TransferFunction(tuple(values[: self.zeros + 1]), (1.0, *values[self.zeros + 1 :])), delay

    def errors(self, x: Floats) -> Complexes:
        """What the model has beyond the measured response [V/V]."""
        model, delay = self.model(x)
        measured = self.measured
        return held_response(model, measured.frequency, measured.period, delay) - measured.value

    def model_error(self, x: Floats) -> float:
        """Relative error of the model that, added to the noise, makes the squared errors what they are."""
        distance, size = np.abs(self.errors(x)), np.abs(self.measured.value)
        free = max(1, 2 * len(size) - len(x))

        def excess(part: float) -> float:
            variance = self.measured.deviation**2 + (part * size) ** 2
            return float(np.sum(distance**2 / variance)) - free

        # Twice the spread of the sum by chance alone.
        if excess(0.0) <= 2.0 * math.sqrt(2.0 * free):
            return 0.0
        high = math.sqrt(float(np.sum((distance / size) ** 2)) / free)  # of a measurement without noise
        return float(scipy.optimize.brentq(excess, 0.0, high * (1.0 + 1e-9), xtol=1e-12))

    def weighted(self, x: Floats, weight: Floats) -> Floats:
        """Real and imaginary parts of the weighted errors."""
        return (self.errors(x) * weight).view(np.float64)

    def stable(self, y: Floats) -> Floats:
        """The unknowns of numerator over static denominator, logarithms of stable factors, and dead time."""
        n, end = self.zeros + 1, len(y) - self.delayed
        below = product(y[n:end])
        return np.concatenate([y[:n] * below[-1], below[1:], y[end:]])

    def minimised(self, start: Floats, weight: Floats, latest: float) -> Floats:
        """The unknowns from ``start`` on that make the weighted errors least; dead time up to ``latest``."""
        n, end = self.zeros + 1, len(start) - self.delayed
        y = np.concatenate([start[:n] / start[end - 1], factors(start[n:end]), start[end:]])
        low, high = np.full(len(y), -np.inf), np.full(len(y), np.inf)
        low[n:end], high[n:end] = -WIDEST, WIDEST
        if self.delayed:
            widest = max(self.measured.period, WIDEST_DELAY / self.measured.frequency[0])
            low[-1], high[-1] = 0.0, min(widest, latest) / self.measured.period
        try:
            search = scipy.optimize.least_squares(
                lambda y: self.weighted(self.stable(y), weight),
                np.clip(y, low + 1e-9, high - 1e-9),
                bounds=(low, high),
                x_scale="jac",
                xtol=1e-12,
                ftol=1e-12,
                gtol=1e-12,
                max_nfev=100,
            )
        except (ValueError, np.linalg.LinAlgError) as error:
            raise ParameterError(f"no model of this order fits the response: {error}") from error
        return self.stable(search.x)


def exact(model: TransferFunction, frequency: Floats, period: float, delay: float, unsure: float) -> Response:
    """The response of a ``model`` at ``frequency`` [Hz], which is ``unsure`` by this part of it."""
    value = held_response(model, frequency, period, delay)
    return Response(frequency, value, unsure * np.abs(value), np.ones(len(value)), period, "model", ())


def product(logarithms: Floats) -> Floats:
    """The stable denominator whose factors these ``logarithms`` are."""
    below = np.ones(1)
    for i in range(0, len(logarithms), 2):
        below = np.polymul(below, np.append(1.0, np.exp(logarithms[i : i + 2])))
    return below


def factors(below: Floats) -> Floats:
    """Logarithms of the factors of a stable denominator, whose coefficients behind the leading 1 are given.

    Those of the second degree come first, of pairs of poles; real ones are paired as they are near.
    """
    poles = np.asarray(np.roots(np.append(1.0, below)), dtype=np.complex128)
    pairs = [p for p in poles if p.imag > 1e-12 * abs(p)]
    real = sorted((-p.real for p in poles if abs(p.imag) <= 1e-12 * abs(p)), reverse=True)
    seconds = [(-2.0 * p.real, abs(p) ** 2) for p in pairs]
    while len(real) >= 2:
        first, second = real.pop(), real.pop()
        seconds.append((first + second, first * second))
    return np.log([c for pair in sorted(seconds, key=lambda pair: pair[1]) for c in pair] + real)


def fit(
    measured: Response, order: int, zeros: int | None = None, delayed: bool = False, latest: float = math.inf
) -> Fit:
    """Stable model of ``order`` with ``zeros`` (two fewer than poles) that comes nearest to ``measured``.

    One unit of error is the standard deviation of the measurement, with a relative error of the model added
    where noise alone does not explain the distance. The model is compared as held and sampled, so that hold
    and sampling bias nothing. ``delayed``: a dead time is estimated too, of ``latest`` [s] at most. Bounds
    come from the Jacobian. Raises ParameterError if there are too few frequencies, or no model fits.
    """
    zeros = max(0, order - 2) if zeros is None else zeros
    form, x, free_error = _start(measured, order, zeros, delayed)
    size = np.abs(measured.value)
    weight = 1.0 / size
    for _ in range(1 + ROUNDS_OF_ERROR):
        x = form.minimised(x, weight, latest)
        model_error = form.model_error(x)
        weight = 1.0 / np.hypot(measured.deviation, model_error * size)
    model, delay = form.model(x)
    _check_poles(model, order, measured)
    distance = np.abs(form.errors(x))
    error = float(np.sqrt(np.mean((distance / size) ** 2)))
    if error > UNSTABLE * free_error:
        raise ParameterError(
            f"the fit of order {order} is unstable: poles to the right miss the response by "
            f"{100.0 * free_error:.2g} %, stable ones by {100.0 * error:.2g} %"
        )
    inverse = np.linalg.pinv(scipy.optimize.least_squares(form.weighted, x, args=(weight,), max_nfev=1).jac)
    quantile = float(scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(1, 2 * len(size) - len(x))))
    # The relative error of the static gain b0/a0 is that of b0 less that of a0.
    b0, a0 = inverse[zeros] / x[zeros], inverse[zeros + order] / x[zeros + order]
    names = [f"b{i}" for i in range(zeros, -1, -1)] + [f"a{i}" for i in range(order - 1, -1, -1)]
    misfit = float(np.sum((distance * weight) ** 2 - 4.0 * np.log(weight)))
    return Fit(
        order=order,
        model=model,
        delay=delay,
        names=(*names, *(["delay"] if delayed else [])),
        values=x * form.units,
        bounds=quantile * np.linalg.norm(inverse, axis=1) * form.units,
        gain_bound=quantile * abs(model.static_gain) * float(np.linalg.norm(b0 - a0)),
        error=error,
        model_error=model_error,
        corners=model_corners(model, delay),
        bounded=model_error <= EXPLAINED or float(np.median(measured.deviation / size)) <= EXCITED,
        criterion=misfit + len(x) * math.log(2 * len(size)),
    )


def _check_poles(model: TransferFunction, order: int, measured: Response) -> None:
    """Raise ParameterError for a ``model`` on the edge of stability or far outside what was ``measured``."""
    poles = np.roots(model.denominator)
    hertz = np.abs(poles) / (2.0 * np.pi)
    damping = -poles.real / np.abs(poles)
    if np.min(damping) < LEAST_DAMPING:
        raise ParameterError(
            f"the fit of order {order} is unstable or on the edge of it (poles at "
            f"{hertz[np.argmin(damping)]:.4g} Hz without damping); choose another order or a better test"
        )
    low, high = float(measured.frequency[0]), float(measured.frequency[-1])
    wider = f"test a wider range, at 500 readings a second or more (these: {1.0 / measured.period:.4g})"
    for at in (float(np.min(hertz)), float(np.max(hertz))):
        if at < DEPTH * low or at > BAND * high:
            raise ParameterError(
                f"the fit of order {order} puts a pole at {at:.4g} Hz, far outside the measured "
                f"{low:.4g} to {high:.4g} Hz; {'choose a lower order' if order > 2 else wider}"
            )


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
            "the valve (--order, --band or a better test)"
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


def choose(measured: Response, order: int | None = None) -> Fit:
    """The simplest of the candidates nearest to ``measured``, by Schwarz's criterion.

    With an ``order`` only the dead time is chosen; there are two more poles than zeros then. Candidates with
    more unknowns are tried until noise alone explains what one leaves. Of those that are nearly as good, or
    that leave nothing but noise, the simplest counts: a coil is a pole without a zero, and a dead time has to
    show itself beside it. One whose coefficients are not in the data gives way to the next best. Raises
    ParameterError if none is left.
    """
    shapes = FORMS if order is None else ((order, order - 2),)
    forms = [(*shape, late) for shape in shapes for late in (False, True)]
    tried: list[tuple[tuple[int, int, bool], Fit]] = []
    refusals: list[ParameterError] = []
    for _, level in groupby(sorted(forms, key=sum), key=sum):  # the number of unknowns, less 1
        for poles, zeros, late in level:
            try:
                tried.append(((zeros, poles, late), fit(measured, poles, zeros, late)))
            except ParameterError as error:
                refusals.append(error)
        if any(one.model_error == 0.0 for _, one in tried):
            break
    while tried:
        # Of the nearest: fewest zeros, then fewest poles, then no dead time.
        least = min(one.criterion for _, one in tried)
        near = [one for one in tried if one[1].criterion <= least + NEAR or one[1].model_error == 0.0]
        best = min(near, key=lambda one: one[0])
        tried = [one for one in tried if one is not best]
        try:
            check_worth(best[1])
            if order is not None or is_clear(best[1]):
                return best[1]
        except ParameterError as error:
            refusals.append(error)
    raise refusals[0]


def hold(frequency: Floats, period: float) -> Complexes:
    """Response of the hold at ``frequency`` [Hz]: nearly half a period of delay."""
    turn = 2j * np.pi * frequency * period
    value: Complexes = -np.expm1(-turn) / turn
    return value


def _start(measured: Response, order: int, zeros: int, delayed: bool) -> tuple[_Form, Floats, float]:
    """Linear least squares for each of several delays; the nearest is where the search begins.

    What lies to the right is mirrored to the left; then the relative error before it is last, else infinity.
    Raises ParameterError if there are too few frequencies.
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
    tried = [(*_linear(value * np.exp(1j * omega * t), s, order, zeros, size), float(t)) for t in delays]
    error, numerator, below, delay = min(tried, key=lambda attempt: attempt[0])
    poles = np.asarray(np.roots(below), dtype=np.complex128)
    left = np.poly(-np.maximum(np.abs(poles.real), 1e-3 * np.abs(poles)) + 1j * poles.imag).real
    powers = np.concatenate([np.arange(order - zeros, order + 1.0), np.arange(1.0, order + 1.0)])
    units, x = scale**powers, np.concatenate([numerator * left[-1] / below[-1], left[1:]])
    if delayed:
        units, x = np.append(units, measured.period), np.append(x, max(0.05, delay / measured.period))
    unstable = math.sqrt(error / len(size)) if np.any(poles.real > 0.0) else math.inf
    return _Form(zeros, delayed, measured, units), x, unstable


def _linear(
    value: Complexes, s: Complexes, order: int, zeros: int, size: Floats
) -> tuple[float, Floats, Floats]:
    """Error, numerator and denominator that make numerator - value·denominator small.

    Each round weighs by the denominator of the one before, so that what is made small becomes the distance.
    """
    powers = np.vander(s, order + 1)
    weight, tried = 1.0 / size, []
    for _ in range(ROUNDS):
        left = np.hstack([powers[:, order - zeros :], -value[:, None] * powers[:, 1:]]) * weight[:, None]
        right = value * powers[:, 0] * weight
        solution, _, _, _ = np.linalg.lstsq(
            np.vstack([left.real, left.imag]), np.concatenate([right.real, right.imag]), rcond=None
        )
        numerator, below = solution[: zeros + 1], np.append(1.0, solution[zeros + 1 :])
        denominator = powers @ below
        distance = np.abs(powers[:, order - zeros :] @ numerator / denominator - value) / size
        tried.append((float(np.sum(distance**2)), numerator, below))
        weight = 1.0 / (size * np.maximum(np.abs(denominator), 1e-9))
    return min(tried, key=lambda attempt: attempt[0])
