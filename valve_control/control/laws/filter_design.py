# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Poles of Bessel filters and second-order sections, bit for bit as `scipy.signal` makes them.

Every law is built when a controller starts, and the import of `scipy.signal` takes half a second.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats

Points = npt.NDArray[Any]  # in the complex plane; real where all of them are

# Poles of Bessel low-passes with -3 dB at 1 rad/s by order, those with a negative imaginary part left out.
BESSEL = {
    1: (-0.9999999999999993 + 0j,),
    2: (-1.1016013305921608 + 0.636009824757034j,),
    3: (-1.0474091610089349 + 0.9992644362806369j, -1.3226757999104441 + 0j),
    4: (-0.995208764350272 + 1.257105739454664j, -1.3700678305514422 + 0.41024971749375155j),
    5: (-0.9576765485626815 + 1.4711243207303943j, -1.3808773258604392 + 0.717909587626768j,
        -1.5023162714474785 + 0j),
    6: (-0.9306565229468591 + 1.6618632689425918j, -1.3818580975965642 + 0.9714718907115716j,
        -1.5714904036160318 + 0.32089637422262396j),
}  # fmt: skip
SAME = 100.0 * np.finfo(np.float64).eps  # largest relative difference of equal numbers
ZERO = 1e-14  # leading coefficient of a numerator, over that of the denominator, which is none


def bessel_poles(order: int, frequency: float) -> Points:
    """Poles [rad/s] of a Bessel low-pass with -3 dB at ``frequency`` [rad/s]."""
    upper = np.array(BESSEL[order])
    return frequency * np.concatenate([upper, upper[upper.imag > 0.0][::-1].conj()])


def zeros_poles_gain(numerator: Floats, denominator: Floats) -> tuple[Points, Points, float]:
    """Zeros, poles and gain of a transfer function in s; coefficients with the highest power first."""
    a = np.trim_zeros(denominator, "f")
    b, a = numerator / a[0], a / a[0]
    while len(b) > 1 and abs(b[0]) <= ZERO:
        b = b[1:]
    return np.roots(b / b[0]), np.roots(a), float(b[0])


def bilinear(zeros: Points, poles: Points, gain: float, rate: float) -> tuple[Points, Points, float]:
    """Zeros, poles and gain in z of those in s by the bilinear transform, for samples at ``rate`` [Hz]."""
    twice = 2.0 * rate
    z = np.concatenate([(twice + zeros) / (twice - zeros), -np.ones(len(poles) - len(zeros))])
    scale = np.real(np.prod(twice - zeros) / np.prod(twice - poles))
    return z, (twice + poles) / (twice - poles), float(gain * scale)


def _upper(points: Points) -> Points:
    """The points with one of each conjugate pair, pairs first."""
    points = points[np.lexsort((abs(points.imag), points.real))]
    real = abs(points.imag) <= SAME * abs(points)
    paired = points[~real]
    above, below = paired[paired.imag > 0.0], paired[paired.imag < 0.0]
    return np.concatenate([(above + below.conj()) / 2.0, points[real].real])


def _worst(poles: Points) -> int:
    """Index of the pole nearest to the unit circle."""
    return int(np.argmin(np.abs(1.0 - np.abs(poles))))


def sections(zeros: Points, poles: Points, gain: float) -> Floats:
    """Rows (b0, b1, b2, 1, a1, a2) of as many zeros as poles in z.

    Each pole goes with the zeros nearest to it; the last row has the poles nearest to the unit circle.
    """
    odd = np.zeros(len(poles) % 2)
    z, p = _upper(np.concatenate([zeros, odd])), _upper(np.concatenate([poles, odd]))
    rows = np.zeros(((len(poles) + 1) // 2, 6))
    for i in range(len(rows) - 1, -1, -1):
        k = _worst(p)
        first, p = p[k], np.delete(p, k)
        if np.isreal(first):
            places = np.flatnonzero(np.isreal(p))
            k = int(places[_worst(p[places])])
            second, p = p[k], np.delete(p, k)
        else:
            second = first.conj()
        k = int(np.argsort(np.abs(z - first))[0])
        one, z = z[k], np.delete(z, k)
        if np.isreal(one):
            order = np.argsort(np.abs(z - first))
            k = int(order[np.isreal(z[order])][0])
            other, z = z[k], np.delete(z, k)
        else:
            other = one.conj()
        rows[i] = [*np.poly([one, other]).real, *np.poly([first, second]).real]
    rows[0, :3] *= gain
    return rows
