# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives a valve that is known by natural frequency, damping and static gain what ``identify`` gives one."""

import math

from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification import first_gains, theta
from valve_control.design.identification.lvdt import Lvdt
from valve_control.design.identification.result import Identification
from valve_control.parameter import Parameter, ParameterError, Values, number

GIVEN = (
    Parameter("--second-order: natural frequency", 18.0, "Hz", "", 0.05, 10000.0),
    Parameter("--second-order: damping", 0.8, "-", "", 0.01, 100.0),
    Parameter("--second-order: static gain", 1.0, "V/V", "", 0.001, 1000.0),
)
SETTABLE = ("sample_period", "u_max", "lvdt.noise", "lvdt.resolution", "lvdt.delay")  # what else may be known


def second_order(frequency: float, damping: float, static_gain: float, valve: Values) -> Identification:
    """The valve g·ω²/(s² + 2·D·ω·s + ω²) with ω = 2π·``frequency`` [Hz] and the static gain g [V/V].

    ``valve``: values of the simulator, of which those in SETTABLE count. Raises ParameterError.
    """
    period, u_max = number(valve, "sample_period"), number(valve, "u_max")
    for row, value in zip(GIVEN, (frequency, damping, static_gain), strict=True):
        row.check(value)
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
    source = f"not measured: {frequency:g} Hz, damping {damping:g}, static gain {static_gain:g} V/V"
    return Identification(source, known, gains.values, gains.notes)
