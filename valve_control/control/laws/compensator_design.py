# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Designs pole-zero compensators for models of the valve, and discretises them into second-order sections.

Poles and sections have the bits of `scipy.signal`. Its import takes half a second, and a controller builds
every law when it starts.
"""

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.laws.biquads import PASS, Params, Section
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.parameter import ParameterError


class DesignError(ParameterError):
    """A compensator that cannot be designed as asked."""


# (12) and (13) as printed.
PRINTED_SECOND_ORDER = TransferFunction(
    tuple(6168503 / 1455.97 * c for c in (1.0, 54.05, 1561.22)),
    (1.0, 470.0, 79652.0, 6168503.0),
)
PRINTED_FOURTH_ORDER = TransferFunction(
    (2880.0, 469440.0, 137833920.0, 5673044160.0, 162874733760.0),
    (1.0, 753.0, 237999.0, 40483517.0, 3703487601.0, 151893300250.0),
)

LARGEST_ORDER = 6  # poles of a compensator: three second-order sections
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


def zeros_poles_gain(model: TransferFunction) -> tuple[Points, Points, float]:
    """Zeros, poles and gain of a transfer function in s."""
    a = np.trim_zeros(np.array(model.denominator), "f")
    b, a = np.array(model.numerator) / a[0], a / a[0]
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


@functools.cache
def pole_zero_compensator(
    model: TransferFunction, bandwidth: float, cancel_zeros: bool = True, order: int = 0
) -> TransferFunction:
    """Compensator that turns a stable ``model`` into a Bessel low-pass of ``bandwidth`` [Hz] (-3 dB).

    It cancels all poles of the model and, with ``cancel_zeros``, those zeros that lie left of the
    imaginary axis; a zero to the right stays in the response, since cancelling it would be unstable.
    ``order``: poles of the Bessel filter; 0 is one more than makes the compensator proper, so that it
    rolls off.

    Raises DesignError for an unstable or improper model, a bandwidth that is not positive, or an order
    too low or too high.
    """
    if bandwidth <= 0.0:
        raise DesignError(f"compensator.bandwidth is {bandwidth:g} Hz; it must be positive")
    zeros, poles, gain = zeros_poles_gain(model)
    if len(zeros) > len(poles):
        raise DesignError(f"the model is improper: it has {len(zeros)} zeros and {len(poles)} poles")
    if len(poles) == 0:
        raise DesignError("the model has no poles, so there is nothing to compensate")
    if np.any(poles.real >= 0.0):
        raise DesignError(
            f"the model has a pole at {poles[np.argmax(poles.real)]:.4g} rad/s; "
            "a pole-zero compensator needs a stable model"
        )
    stable = zeros.real < 0.0 if cancel_zeros else np.zeros(len(zeros), dtype=bool)
    cancelled, kept = zeros[stable], zeros[~stable]
    least = len(poles) - len(cancelled)
    order = order or least + 1
    if order < least:
        raise DesignError(
            f"compensator.order is {order}; with fewer than {least} poles the compensator would be improper"
        )
    if order + len(cancelled) > LARGEST_ORDER:
        raise DesignError(
            f"the compensator would have {order + len(cancelled)} poles; it may have {LARGEST_ORDER}"
        )
    target = bessel_poles(order, 2.0 * np.pi * bandwidth)
    denominator = np.poly(np.concatenate([target, cancelled])).real
    numerator = np.poly(poles).real
    static = gain * np.prod(-kept).real * np.prod(-cancelled).real / np.prod(-poles).real
    if static == 0.0:
        raise DesignError("the model has a zero at 0 rad/s, so its static gain cannot be compensated")
    numerator = numerator * (denominator[-1] / numerator[-1] / static)
    return TransferFunction(tuple(map(float, numerator)), tuple(map(float, denominator)))


@functools.cache
def compensator_params(transfer_function: TransferFunction, period: float, u_max: float) -> Params:
    """Sections of a continuous compensator, discretised by the bilinear transform at ``period`` [s].

    The bilinear transform adds no delay of its own, and at 25 Hz and 1 kHz warps frequency by 0.2 %.
    """
    found = bilinear(*zeros_poles_gain(transfer_function), 1.0 / period)
    rows = [Section(*(float(c) for c in (*row[:3], *row[4:]))) for row in sections(*found)]
    first, second, third = rows + [PASS] * (3 - len(rows))
    return Params(first, second, third, transfer_function.static_gain, u_max)
