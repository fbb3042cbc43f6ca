# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives a valve that is known by natural frequency, damping and static gain what ``identify`` gives one."""

import math
from typing import Any, NamedTuple

from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification import bode, first_gains, result, theta
from valve_control.design.identification.bode import Corners
from valve_control.design.identification.lvdt import Lvdt
from valve_control.parameter import Parameter, ParameterError, Values, number

GIVEN = (
    Parameter("natural frequency", 18.0, "Hz", "", 0.05, 10000.0),
    Parameter("damping", 0.8, "-", "", 0.01, 100.0),
    Parameter("static gain", 1.0, "V/V", "", 0.001, 1000.0),
)
SETTABLE = ("sample_period", "u_max", "lvdt.noise", "lvdt.resolution", "lvdt.delay")  # what else may be known


class Datasheet(NamedTuple):
    """A valve of second order that was not measured, with its first gains."""

    source: str
    known: first_gains.KnownValve
    gains: Values  # of the controller, for a first run
    corners: Corners
    notes: tuple[str, ...]


def second_order(frequency: float, damping: float, static_gain: float, valve: Values) -> Datasheet:
    """The valve g·ω²/(s² + 2·D·ω·s + ω²) with ω = 2π·``frequency`` [Hz] and the static gain g [V/V].

    ``valve``: values of the simulator, of which those in SETTABLE count. Raises ParameterError.
    """
    period, u_max = number(valve, "sample_period"), number(valve, "u_max")
    for row, value in zip(GIVEN, (frequency, damping, static_gain), strict=True):
        try:
            row.check(value)
        except ParameterError as error:
            raise ParameterError(f"--second-order: {error}") from error
    if frequency >= 0.5 / period:
        raise ParameterError(
            f"--second-order: the natural frequency is {frequency:g} Hz, not below Nyquist's frequency, "
            f"{0.5 / period:g} Hz; give a shorter --sample-period"
        )
    omega = 2.0 * math.pi * frequency
    model = TransferFunction((static_gain * omega**2,), (1.0, 2.0 * damping * omega, omega**2))
    delay = number(valve, "lvdt.delay")
    readings = Lvdt(number(valve, "lvdt.noise"), number(valve, "lvdt.resolution"))
    known = first_gains.KnownValve(
        model, delay, theta.around(model, u_max), readings, period, u_max, sensor_delay=delay
    )
    gains = first_gains.first(known)
    return Datasheet(
        f"not measured: {frequency:g} Hz, damping {damping:g}, static gain {static_gain:g} V/V",
        known,
        gains.values,
        bode.model_corners(model, delay),
        gains.notes,
    )


def parameters(found: Datasheet) -> dict[str, Values]:
    """Parameters for the nodes, those that ``result.parameters`` has for a valve that was measured."""
    return result.parameters_of(found.known, found.known.delay > 0.0, found.gains)


def yaml_text(found: Datasheet) -> str:
    """A ROS 2 parameter file of ``parameters``."""
    return result.parameter_file(
        parameters(found),
        [
            f"Given: {found.source}",
            "arc, oarc: bounds for 0.67 to 1.5 times the gain and 0.8 to 1.25 times the speed.",
            *result.STABLE,
        ],
    )


def text(found: Datasheet) -> str:
    """The valve as the terminal shows it."""
    numerator, denominator = map(result.polynomial, found.known.model)
    lines = [
        found.source,
        f"({numerator}) / ({denominator})",
        f"  -3 dB at {result.hertz(found.corners.minus_3db)}, -90° at {result.hertz(found.corners.minus_90)}",
        result.theta_text(found.known.theta),
        *(f"note: {note}" for note in found.notes),
    ]
    return "\n".join(lines)


def as_dict(found: Datasheet) -> dict[str, Any]:
    """The valve for JSON."""
    known = found.known
    return {
        "source": found.source,
        "sample_period": known.period,
        "u_max": known.u_max,
        "model": {
            "numerator": list(known.model.numerator),
            "denominator": list(known.model.denominator),
            "delay_s": known.delay,
            "static_gain": known.model.static_gain,
            **result.corners_dict(found.corners),
        },
        "theta": result.theta_dict(known.theta),
        "lvdt": known.lvdt._asdict(),
        "gains": found.gains,
        "notes": list(found.notes),
    }
