# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes responses, corners and roots of known transfer functions; bode_fit.py fits unknown ones."""

import cmath
import math
from typing import NamedTuple

import numpy as np
import scipy.signal

from valve_control.arrays import Complexes, Floats
from valve_control.control.plant.transfer_functions import TransferFunction

GRID: Floats = np.geomspace(1e-5, 1e4, 4000)  # Hz, where corners are looked for
APART = 1e-8  # of a pole, by which the poles of partial fractions are apart at least


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
    time ``delay`` [s] need not be a whole number of periods. The model has more poles than zeros, and no pole
    at 0; partial fractions, so equal poles are taken apart by APART.
    """
    denominator = np.trim_zeros(np.asarray(model.denominator, dtype=np.float64), "f")
    poles = np.roots(denominator).astype(np.complex128)
    poles *= 1.0 + APART * np.arange(len(poles))
    between = poles[:, None] - poles + np.eye(len(poles))
    residues = np.polyval(model.numerator, poles) / (denominator[0] * np.prod(between, axis=1))
    z = np.exp(2j * np.pi * frequency * period)
    state = np.expm1(poles * period) / poles / (z[:, None] - np.exp(poles * period))
    whole = math.floor(delay / period + 1e-12)
    part = max(0.0, delay / period - whole)
    if part == 0.0:
        value: Complexes = (state @ residues) * z ** (-whole)
        return value
    # Between two samples the state runs on for the rest of the period under the input of its beginning.
    rest = poles * period * (1.0 - part)
    later: Complexes = (state * np.exp(rest) + np.expm1(rest) / poles) @ residues * z ** (-(whole + 1))
    return later


def corners(frequency: Floats, value: Complexes) -> Corners:
    """First of the rising ``frequency`` [Hz] where ``value`` is -3 dB and -90° from its first, if it is."""
    relative = value / value[0]
    reached: list[float | None] = []
    for size, level in ((decibels(relative), -3.0), (degrees(relative), -90.0)):
        first = int(np.argmax(size < level))
        ends = slice(first - 1, first + 1)
        between = np.interp(-level, -size[ends], np.log(frequency[ends])) if first else None
        reached.append(None if between is None else float(np.exp(between)))
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
    return corners(GRID, response(model, GRID, delay))


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
