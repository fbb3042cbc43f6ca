# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Predicts swings about rest that friction sustains, by the describing function of the valve's friction.

The bristles of the simulated friction obey dz/dt = (v - |v|·z)/δ, friction is F·z (Dahl 1968). In a swing
x = A·sin(ωt) they go along a hysteresis loop, from -tanh(α) to tanh(α) and back, with α = A/δ. Its first
harmonic over that of x is (F/δ)·n(α), whatever the frequency, with

    n(α) = 2·I1(α)/(α·cosh α) + j·4·(α - tanh α)/(π·α²),

I1 the modified Bessel function: a spring of F/δ for the smallest swings, which wears off and rubs in larger
ones, until 4·F/(π·A) of Coulomb friction is left, a quarter of a period ahead of x. A loop of the valve G
and the law -C swings by itself where 1 + C·G + N·G = 0 (Gelb and Vander Velde, Multiple-Input Describing
Functions and Nonlinear System Design, 1968, section 3.1), that is where N = -(1/G + C).

In the sampled valve the bristles are ahead of that, for small swings by one and a half periods: their force
over a period is that of its end, and backward Euler takes the velocity of the end for the whole of it.
Coulomb friction is ahead by the first of these alone. Stribeck's addition is left out: a swing is faster.
"""

import math

import numpy as np
import scipy.special

from valve_control.arrays import Complexes, Floats
from valve_control.control.compiling import compile_function

AHEAD = 1.5  # periods by which the sampled bristles are ahead of the position in small swings
RUBBING_AHEAD = 1.0  # the same of Coulomb friction
DEFLECTIONS = np.geomspace(1e-3, 1e3, 600)  # α that are tabulated; beyond, n(α) is that of Coulomb friction


def describing_function(deflection: Floats) -> Complexes:
    """n(α) of the ``deflection`` α = A/δ > 0, in parts of F/δ."""
    a = np.asarray(deflection, dtype=float)
    spring = 4.0 * scipy.special.i1e(a) / (a * (1.0 + np.exp(-2.0 * a)))
    with np.errstate(invalid="ignore"):
        rubbing = np.where(a < 1e-2, 4.0 * a / (3.0 * np.pi), 4.0 * (a - np.tanh(a)) / (np.pi * a * a))
    return np.asarray(spring + 1j * rubbing, dtype=complex)


_TABLE = describing_function(DEFLECTIONS)
_PHASE, _SIZE = np.angle(_TABLE), np.abs(_TABLE)


def swings(loop: Complexes, position: Complexes, z: Complexes, coulomb: Floats, presliding: Floats) -> Floats:
    """Amplitude [V] of the largest swing about rest that friction sustains on each of N valves; 0.0: none.

    ``loop`` (N×F): C·G of the reading, at ``z`` (F) of ascending frequency. ``position`` (N×F): G [V/V]
    without the sensor's dead time, since friction acts on the spool itself. ``coulomb`` [V] and
    ``presliding`` [V] (N): friction of the valve. Less than these counts too, for friction is another one on
    the next day. ``presliding`` 0.0: Coulomb friction without a spring.
    """
    amplitudes = np.empty(len(coulomb))
    ahead = z**-AHEAD, z**-RUBBING_AHEAD
    compile_function(_largest, nogil=True)(
        loop, position, *ahead, coulomb, presliding, _PHASE, _SIZE, DEFLECTIONS, amplitudes
    )
    return amplitudes


def _largest(
    loop: Complexes,
    position: Complexes,
    ahead: Complexes,
    rubbing_ahead: Complexes,
    coulomb: Floats,
    presliding: Floats,
    phases: Floats,
    sizes: Floats,
    deflections: Floats,
    amplitudes: Floats,
) -> None:
    """Fill ``amplitudes`` (N) as ``swings``; ``phases``, ``sizes`` and ``deflections``: table of n(α).

    Without a spring: where what is missing crosses the positive imaginary axis.
    """
    for i in range(len(amplitudes)):
        largest, before = 0.0, 0.0 + 0.0j
        for k in range(len(ahead)):
            bare = -(1.0 + loop[i, k]) / position[i, k]
            if presliding[i] > 0.0:
                missing = bare * ahead[k]
                if missing.real > 0.0 and missing.imag > 0.0:
                    phase = math.atan2(missing.imag, missing.real)
                    stiffness = abs(missing) / _between(phase, phases, sizes)  # V/V  F/δ that swings there
                    most = min(presliding[i], coulomb[i] / stiffness)
                    largest = max(largest, _between(phase, phases, deflections) * most)
            else:
                missing = bare * rubbing_ahead[k]
                if before.real * missing.real < 0.0:
                    share = before.real / (before.real - missing.real)
                    at = before.imag + share * (missing.imag - before.imag)
                    if at > 0.0:
                        largest = max(largest, 4.0 * coulomb[i] / (math.pi * at))
                before = missing
        amplitudes[i] = largest


def _between(x: float, places: Floats, values: Floats) -> float:
    """``values`` at ``x`` between ascending ``places``, interpolated; beyond them, the one at the end."""
    after = np.searchsorted(places, x)
    if after == 0:
        return float(values[0])
    if after == len(places):
        return float(values[-1])
    share = (x - places[after - 1]) / (places[after] - places[after - 1])
    return float(values[after - 1] + share * (values[after] - values[after - 1]))
