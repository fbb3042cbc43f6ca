# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Designs pole-zero compensators for models of the valve, and discretises them into second-order sections."""

import functools

import numpy as np

from valve_control.control.laws import filter_design
from valve_control.control.laws.biquads import PASS, Params, Section
from valve_control.control.plant.models import TransferFunction


class DesignError(ValueError):
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
    zeros, poles, gain = _zeros_poles_gain(model)
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
    target = filter_design.bessel_poles(order, 2.0 * np.pi * bandwidth)
    denominator = np.poly(np.concatenate([target, cancelled])).real
    numerator = np.poly(poles).real
    static = gain * np.prod(-kept).real * np.prod(-cancelled).real / np.prod(-poles).real
    if static == 0.0:
        raise DesignError("the model has a zero at 0 rad/s, so its static gain cannot be compensated")
    numerator = numerator * (denominator[-1] / numerator[-1] / static)
    return TransferFunction(tuple(map(float, numerator)), tuple(map(float, denominator)))


def _zeros_poles_gain(model: TransferFunction) -> tuple[filter_design.Points, filter_design.Points, float]:
    return filter_design.zeros_poles_gain(np.array(model.numerator), np.array(model.denominator))


@functools.cache
def compensator_params(transfer_function: TransferFunction, period: float, u_max: float) -> Params:
    """Sections of a continuous compensator, discretised by the bilinear transform at ``period`` [s].

    The bilinear transform adds no delay of its own, and at 25 Hz and 1 kHz warps frequency by 0.2 %.
    """
    found = filter_design.bilinear(*_zeros_poles_gain(transfer_function), 1.0 / period)
    sos = filter_design.sections(*found)
    sections = [Section(*(float(c) for c in (*row[:3], *row[4:]))) for row in sos]
    sections += [PASS] * (3 - len(sections))
    static_gain = transfer_function.static_gain
    first, second, third = sections
    return Params(first, second, third, static_gain, u_max)


def static_params(valve_gain: float, u_max: float) -> Params:
    """The open loop without compensator: command divided by the valve's static gain [V/V]."""
    section = Section(1.0 / valve_gain, 0.0, 0.0, 0.0, 0.0)
    return Params(section, PASS, PASS, static_gain=1.0 / valve_gain, u_max=u_max)
