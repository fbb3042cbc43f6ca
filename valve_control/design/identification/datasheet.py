# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives a valve that is known by its data sheet what ``identify`` gives one that was tested."""

import math

import numpy as np
import scipy.optimize
import scipy.signal

from valve_control.control.parameters.table import NODES
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.identification import experiment, first_gains, theta
from valve_control.design.identification.friction import Friction
from valve_control.design.identification.lvdt import Lvdt
from valve_control.design.identification.result import Identification
from valve_control.parameter import Parameter, ParameterError, Values, defaults, lookup, number, updated

OF_SIMULATOR = ("sample_period", "u_max", "lvdt.noise", "lvdt.resolution", "lvdt.delay")
SHEET = (  # what a data sheet has
    Parameter("natural_frequency", 0.0, "Hz", "of the spool, where it lags by 90°; or", 0.0, 3000.0),
    Parameter("step_time", 0.0, "s", "from a step of the voltage to 90 % of the way", 0.0, 100.0),
    Parameter("damping", 0.8, "-", "of the spool", 0.01, 100.0),
    Parameter("full_stroke", 10.0, "V", "reading of the LVDT at the voltage u_max", 0.01, 1000.0),
    Parameter("hysteresis", 0.0, "%", "width of the loop of position over voltage, of u_max", 0.0, 50.0),
    *(lookup(NODES["valve_simulator"], name) for name in OF_SIMULATOR),
)
REACHED = 0.9  # of a step


def valve(changes: Values) -> Identification:
    """The valve of a data sheet, of which ``changes`` has what it says in the names of SHEET.

    A spool of second order, with friction of half the hysteresis. Raises ParameterError.
    """
    sheet = updated(SHEET, defaults(SHEET), changes)
    names = ("natural_frequency", "damping", "full_stroke", "hysteresis", "sample_period", "u_max")
    frequency, damping, stroke, hysteresis, period, u_max = (number(sheet, name) for name in names)
    delay = number(sheet, "lvdt.delay")
    if (frequency > 0.0) == (number(sheet, "step_time") > 0.0):
        raise ParameterError("a data sheet needs natural_frequency or step_time; give one of them")
    frequency = frequency or _frequency(number(sheet, "step_time"), damping)
    if frequency >= 0.5 / period:
        raise ParameterError(
            f"the natural frequency is {frequency:.4g} Hz, not below Nyquist's frequency, {0.5 / period:g} "
            "Hz; give a shorter sample_period"
        )
    gain, half = stroke / u_max, 0.005 * hysteresis * u_max  # V/V, V
    model = _model(frequency, damping, gain)
    known = first_gains.KnownValve(
        model=model,
        delay=delay,
        theta=theta.around(model, u_max),
        lvdt=Lvdt(number(sheet, "lvdt.noise"), number(sheet, "lvdt.resolution")),
        period=period,
        u_max=u_max,
        friction=Friction(half, 0.0, gain, 0.0, 0) if half > 0.0 else None,
        sensor_delay=delay,
    )
    gains = first_gains.first(known)
    rows = (f"{name} {value:g} {lookup(SHEET, name).unit}" for name, value in changes.items())
    source = "data sheet: " + ", ".join(row.removesuffix(" -") for row in rows)
    notes = (*experiment.period_notes(period, model), *gains.notes)
    return Identification(source, known, gains.values, notes)


def _model(frequency: float, damping: float, gain: float) -> TransferFunction:
    """g·ω²/(s² + 2·D·ω·s + ω²) with ω = 2π·``frequency`` [Hz]."""
    omega = 2.0 * math.pi * frequency
    return TransferFunction((gain * omega**2,), (1.0, 2.0 * damping * omega, omega**2))


def _frequency(step_time: float, damping: float) -> float:
    """Natural frequency [Hz] with which a step has gone REACHED of its way after ``step_time`` [s]."""
    time = np.linspace(0.0, step_time, 2001)

    def beyond(logarithm: float) -> float:
        numerator, denominator = _model(math.exp(logarithm) / step_time, damping, 1.0)
        return float(np.max(scipy.signal.step((numerator, denominator), T=time)[1])) - REACHED

    return math.exp(float(scipy.optimize.brentq(beyond, math.log(1e-3), math.log(1e3)))) / step_time
