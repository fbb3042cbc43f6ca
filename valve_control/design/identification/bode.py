# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes frequency responses, corners and roots of transfer functions, continuous and sampled."""

import cmath
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.signal

from valve_control.arrays import Complexes, Floats
from valve_control.control.laws import biquads
from valve_control.control.plant.models import TransferFunction

LOWEST, HIGHEST = 1e-5, 1e4  # Hz between which corners are looked for
GRID = 4000  # frequencies of that search
APART = 1e-6  # of a pole, by which the poles of partial fractions are apart at least


class Root(NamedTuple):
    """A real pole or zero, or a pair of complex ones."""

    frequency: float  # Hz, |s|/2π
    damping: float  # -Re s/|s|; below 0 right of the imaginary axis
    pair: bool


class Corners(NamedTuple):
    """Frequencies at which a response falls to -3 dB and to -90°."""

    minus_3db: float | None  # Hz
    minus_90: float | None  # Hz


def response(model: TransferFunction, frequency: Floats, delay: float = 0.0) -> Complexes:
    """Continuous response at ``frequency`` [Hz] with a dead time ``delay`` [s]."""
    w = 2.0 * np.pi * frequency
    _, value = scipy.signal.freqs(model.numerator, model.denominator, w)
    late: Complexes = value * np.exp(-1j * w * delay)
    return late


def held_response(model: TransferFunction, frequency: Floats, period: float, delay: float = 0.0) -> Complexes:
    """Response from held input to sampled output at ``frequency`` [Hz], exact below Nyquist's frequency.

    Input k is held from t_k to t_k + ``period`` [s]; output k is read at t_k, just before input k counts.
    So y_k depends on inputs up to k-1, as in the loop, and the hold's half sample of delay is in it. The dead
    time ``delay`` [s] need not be a whole number of periods. The model has more poles than zeros.
    """
    scaled, scale = _time_scaled(model)
    a, b, c = _companion(scaled)
    n = len(b)
    whole = math.floor(delay / period + 1e-12)
    part = max(0.0, delay / period - whole)
    hold, drive = _held(a, b, period * scale)
    z = np.exp(2j * np.pi * frequency * period)
    pencil = z[:, None, None] * np.eye(n) - hold
    state = np.linalg.solve(pencil, np.broadcast_to(drive, (len(z), n, 1)))[:, :, 0]
    if part == 0.0:
        value: Complexes = (state @ c) * z ** (-whole)
        return value
    # Between two samples the state runs on for the rest of the period under the input of its beginning.
    rest, driven = _held(a, b, period * scale * (1.0 - part))
    later: Complexes = (state @ (c @ rest) + c @ driven[:, 0]) * z ** (-(whole + 1))
    return later


def quick_held_response(
    model: TransferFunction, frequency: Floats, period: float, delay: float = 0.0
) -> Complexes:
    """``held_response`` of a stable model by its partial fractions, in a tenth of the time.

    Poles are taken up to 3e-6 of themselves away, so that no two are the same: five digits hold.
    """
    poles = np.roots(model.denominator).astype(np.complex128)
    poles *= 1.0 + APART * np.arange(len(poles))
    between = poles[:, None] - poles + np.eye(len(poles))
    residues = np.polyval(model.numerator, poles) / (model.denominator[0] * np.prod(between, axis=1))
    turn = np.exp(poles * period)
    z = np.exp(2j * np.pi * frequency * period)
    state = (turn - 1.0) / poles / (z[:, None] - turn)
    whole = math.floor(delay / period + 1e-12)
    part = max(0.0, delay / period - whole)
    if part == 0.0:
        value: Complexes = (state @ residues) * z ** (-whole)
        return value
    rest = np.exp(poles * period * (1.0 - part))
    later: Complexes = (state * rest + (rest - 1.0) / poles) @ residues * z ** (-(whole + 1))
    return later


def _held(a: Floats, b: Floats, time: float) -> tuple[Floats, Floats]:
    """Transition and input matrix of x' = a·x + b·u over ``time`` with u held."""
    n = len(b)
    transition, drive, *_ = scipy.signal.cont2discrete((a, b[:, None], np.eye(n), np.zeros((n, 1))), time)
    return transition, drive


def _time_scaled(model: TransferFunction) -> tuple[TransferFunction, float]:
    """``model`` over s/scale, its highest denominator coefficient 1; scale [rad/s] is its poles' middle."""
    denominator = np.trim_zeros(np.asarray(model.denominator, dtype=np.float64), "f")
    numerator = np.trim_zeros(np.asarray(model.numerator, dtype=np.float64), "f")
    n = len(denominator) - 1
    scale = float(np.exp(np.mean(np.log(np.maximum(np.abs(np.roots(denominator)), 1e-3)))))
    d = denominator / denominator[0] * scale ** -np.arange(n + 1.0)
    m = numerator / denominator[0] * scale ** -(np.arange(len(numerator)) + n + 1.0 - len(numerator))
    return TransferFunction(tuple(map(float, m)), tuple(map(float, d))), scale


def _companion(model: TransferFunction) -> tuple[Floats, Floats, Floats]:
    """Matrices A, B, C of the controllable form of a model."""
    n = len(model.denominator) - 1
    a = np.diag(np.ones(n - 1), 1)
    a[-1] = -np.asarray(model.denominator[1:])[::-1]
    b = np.zeros(n)
    b[-1] = 1.0
    c = np.zeros(n)
    c[: len(model.numerator)] = model.numerator[::-1]
    return a, b, c


def _sections(p: biquads.Params) -> list[list[float]]:
    return [[g.b0, g.b1, g.b2, 1.0, g.a1, g.a2] for g in (p.first, p.second, p.third)]


def sections_response(p: biquads.Params, frequency: Floats, period: float) -> Complexes:
    """Response of a compensator's sections at ``frequency`` [Hz], one sample every ``period`` [s]."""
    delay = np.exp(-2j * np.pi * frequency * period)
    value = np.ones(len(frequency), dtype=np.complex128)
    for b0, b1, b2, _, a1, a2 in _sections(p):
        value *= (b0 + delay * (b1 + delay * b2)) / (1.0 + delay * (a1 + delay * a2))
    return value


def step_peak(p: biquads.Params, samples: int) -> float:
    """Largest output of a compensator's sections within so many ``samples`` after a step by 1, unlimited."""
    return float(np.max(np.abs(scipy.signal.sosfilt(_sections(p), np.ones(samples)))))


def corners(evaluate: Callable[[Floats], Complexes], highest: float = HIGHEST) -> Corners:
    """First frequencies [Hz] of -3 dB and -90°, relative to the response's value at ``LOWEST``."""
    frequency = np.geomspace(LOWEST, highest, GRID)
    reached: list[float | None] = []
    for read, level in ((decibels, -3.0), (degrees, -90.0)):
        value = evaluate(frequency)
        below = np.flatnonzero(read(value / value[0]) < level)
        if len(below) == 0 or below[0] == 0:
            reached.append(None)
            continue
        last = int(below[0])
        # The start stays in, since both are counted from there; the bracket is made fine.
        fine = np.concatenate([frequency[:last], np.linspace(frequency[last - 1], frequency[last], 200)[1:]])
        value = evaluate(fine)
        relative = read(value / value[0])[last - 1 :]
        i = int(np.argmax(relative < level))
        f0, f1 = fine[last - 2 + i], fine[last - 1 + i]
        part = (relative[i - 1] - level) / (relative[i - 1] - relative[i])
        reached.append(float(f0 + part * (f1 - f0)))
    return Corners(*reached)


def decibels(value: Complexes) -> Floats:
    """Size in dB."""
    size: Floats = 20.0 * np.log10(np.maximum(np.abs(value), 1e-300))
    return size


def degrees(value: Complexes) -> Floats:
    """Phase [°] without leaps."""
    turn: Floats = np.degrees(np.unwrap(np.angle(value)))
    return turn


def model_corners(model: TransferFunction, delay: float = 0.0) -> Corners:
    """-3 dB and -90° of a continuous model."""
    return corners(lambda frequency: response(model, frequency, delay))


def roots(coefficients: tuple[float, ...]) -> list[Root]:
    """Roots of a polynomial in s, slowest first; a complex pair is one entry."""
    found = []
    for value in np.roots(np.trim_zeros(np.asarray(coefficients, dtype=np.float64), "f")):
        size = abs(value)
        pair = abs(value.imag) > 1e-9 * size
        if not pair or value.imag > 0.0:
            damping = -math.cos(cmath.phase(value)) if size > 0.0 else 0.0
            found.append(Root(size / (2.0 * math.pi), damping, pair))
    return sorted(found, key=lambda root: root.frequency)
