# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives a valve that is known by its data sheet what ``identify`` gives one that was tested."""

import math

import numpy as np
import scipy.optimize
import scipy.signal

from valve_control.control.parameters.table import NODES
from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification import first_gains, rational, theta
from valve_control.design.identification.friction import Friction
from valve_control.design.identification.lvdt import Lvdt
from valve_control.design.identification.result import Identification
from valve_control.parameter import (
    Parameter,
    ParameterError,
    Value,
    Values,
    defaults,
    lookup,
    number,
    updated,
)

OF_SIMULATOR = ("sample_period", "u_max", "lvdt.noise", "lvdt.resolution", "lvdt.delay")
SHEET = (  # what a data sheet has
    Parameter("natural_frequency", 0.0, "Hz", "of the spool, where it lags by 90°; or", 0.0, 3000.0),
    Parameter("step_time", 0.0, "s", "from a step of the voltage to 90 % of the way", 0.0, 100.0),
    Parameter("damping", 0.8, "-", "of the spool", 0.01, 100.0),
    Parameter("full_stroke", 10.0, "V", "reading of the LVDT at the voltage u_max", 0.01, 1000.0),
    Parameter("hysteresis", 0.0, "%", "width of the loop of position over voltage, of u_max", 0.0, 50.0),
    Parameter("coil", 0.0, "s", "lag L/R of a solenoid; 0: a valve without solenoids", 0.0, 0.5),
    Parameter("asymmetry", 0.0, "%", "more stroke to positive than to negative positions", -90.0, 90.0),
    *(lookup(NODES["valve_simulator"], name) for name in OF_SIMULATOR),
)
REACHED = 0.9  # of a step
PRESLIDING = 0.02  # V  which no data sheet has, of usual bristles
FREQUENCIES, CERTAIN = 40, 0.01  # of the response to which the second order is fitted, and of it


def valve(changes: Values) -> Identification:
    """The valve of a data sheet, of which ``changes`` has what it says in the names of SHEET.

    A spool of second order, with friction of half the hysteresis. With a coil or unequal sides it is a valve
    with solenoids, of whose hysteresis magnet and friction have half each. Raises ParameterError.
    """
    sheet = updated(SHEET, defaults(SHEET), changes)
    frequency, damping, stroke, hysteresis, coil, more, period, u_max, delay = (
        number(sheet, name)
        for name in (
            "natural_frequency", "damping", "full_stroke", "hysteresis", "coil", "asymmetry", "sample_period",
            "u_max", "lvdt.delay",
        )
    )  # fmt: skip
    if (frequency > 0.0) == (number(sheet, "step_time") > 0.0):
        raise ParameterError("a data sheet needs natural_frequency or step_time; give one of them")
    if more != 0.0 and coil == 0.0:
        raise ParameterError(f"an asymmetry of {more:g} % is that of two solenoids; give their coil [s] too")
    frequency = frequency or _frequency(number(sheet, "step_time"), damping, coil)
    if frequency >= 0.5 / period:
        raise ParameterError(
            f"the natural frequency is {frequency:.4g} Hz, not below Nyquist's frequency, {0.5 / period:g} "
            "Hz; give a shorter sample_period"
        )
    gain, half = stroke / u_max, 0.005 * hysteresis * u_max  # V/V, V
    second = model = _model(frequency, damping, gain, coil)
    simulated, magnet = dict[str, Value](), None
    if coil > 0.0:
        half *= 0.5
        magnet = first_gains.Magnet(coil, half, 0.01 * more)
        f = np.geomspace(0.05 * frequency, min(5.0 * frequency, 0.4 / period), FREQUENCIES)
        second = rational.fit(rational.exact(model, f, period, 0.0, CERTAIN), 2).model
        simulated = {
            "valve": "solenoid",
            "solenoid.natural_frequency": frequency,
            "solenoid.damping": damping,
            "solenoid.gain": gain,
            "solenoid.coil": coil,
            "solenoid.hysteresis": 2.0 * half,
            "solenoid.positive": 1.0 + 0.005 * more,
            "solenoid.negative": 1.0 - 0.005 * more,
            "solenoid.u_min": -u_max,
            "friction.presliding": PRESLIDING,
        }
    known = first_gains.KnownValve(
        model=model,
        delay=delay,
        theta=theta.around(second, u_max),
        lvdt=Lvdt(number(sheet, "lvdt.noise"), number(sheet, "lvdt.resolution")),
        period=period,
        u_max=u_max,
        friction=Friction(half, 0.0, gain, 0.0, 0) if half > 0.0 else None,
        sensor_delay=delay,
        magnet=magnet,
    )
    gains = first_gains.first(known)
    rows = (f"{name} {value:g} {lookup(SHEET, name).unit}" for name, value in changes.items())
    source = "data sheet: " + ", ".join(row.removesuffix(" -") for row in rows)
    return Identification(source, known, gains.values, gains.notes, simulated=simulated)


def _model(frequency: float, damping: float, gain: float, coil: float) -> TransferFunction:
    """g·ω²/((s² + 2·D·ω·s + ω²)·(T·s + 1)) with ω = 2π·``frequency`` [Hz]; T: ``coil`` [s]."""
    omega = 2.0 * math.pi * frequency
    lag = [1.0, 1.0 / coil] if coil > 0.0 else [1.0]
    below = np.polymul([1.0, 2.0 * damping * omega, omega**2], lag).tolist()
    return TransferFunction((gain * below[-1],), tuple(below))


def _frequency(step_time: float, damping: float, coil: float) -> float:
    """Natural frequency [Hz] with which a step has gone REACHED of its way after ``step_time`` [s]."""
    time = np.linspace(0.0, step_time, 2001)

    def beyond(logarithm: float) -> float:
        numerator, denominator = _model(math.exp(logarithm) / step_time, damping, 1.0, coil)
        return float(np.max(scipy.signal.step((numerator, denominator), T=time)[1])) - REACHED

    low, high = math.log(1e-3), math.log(1e3)
    if not beyond(low) < 0.0 < beyond(high):
        raise ParameterError(
            f"no spool with a damping of {damping:g} behind a coil of {coil:g} s takes {step_time:g} s for a "
            f"step (step_time); the coil alone takes {-coil * math.log(1.0 - REACHED):.3g} s"
        )
    return math.exp(float(scipy.optimize.brentq(beyond, low, high))) / step_time
