# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Derives the controller's model and estimates from the fitted valve, and the box of valves to tune for."""

import math
from itertools import islice

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.commands import scenarios
from valve_control.control.commands.arrays import sampled
from valve_control.control.laws.dcarc_design import MOST_DELAY
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.simulation.robustness import Quantity
from valve_control.design.commissioning.bench import SafetyLimits
from valve_control.design.commissioning.evaluation import Rest
from valve_control.design.commissioning.valve_fit import Plant
from valve_control.design.identification import bode_fit, dead_time, first_gains, theta
from valve_control.design.identification.friction import Friction
from valve_control.design.identification.lvdt import Lvdt
from valve_control.design.identification.response import Response
from valve_control.design.tuning.trial import TuningMotion
from valve_control.parameter import ParameterError, Values

FREQUENCIES = 40
LOWEST, HIGHEST = 0.5, 100.0  # Hz
FASTEST = 0.2  # of the sampling frequency
LATE = 0.2  # sample periods of dead time from which on a model has one
CERTAIN = 0.01  # of the response
SPREAD = 0.1  # of gain and speed, that one valve has from day to day
RUBBING = 0.3  # of friction, likewise
OFFSET = 0.2  # V  likewise
LATER = 0.5  # sample periods, likewise
DRIVEN = 0.7  # of the limit of the voltage, that motions may need
ROOM = 0.65  # of the travel, that they may take
STATIC = 0.5  # of what the voltage reaches, that they may take
ACCELERATION = 8.0  # 1/s  times the velocity of a stroke, as in the default motion
PAUSE = 0.4  # s  after a stroke
SINE = 0.3  # of the stroke
LONG = 1.5  # s  least length of the sine


class Known:
    """What the controller gets to know of the valve."""

    def __init__(
        self, plant: Plant, rest: Rest, period: float, u_max: float, law: str, sensor_delay: float = 0.0
    ) -> None:
        """Fit the models of the laws to ``plant``, and see that ``law`` can take its own.

        Raises ParameterError.
        """
        frequency = np.geomspace(LOWEST, min(HIGHEST, FASTEST / period), FREQUENCIES)
        exact = bode_fit.exact(plant.model, frequency, period, plant.delay, CERTAIN)
        order, zeros = len(plant.model.denominator) - 1, len(plant.model.numerator) - 1
        late = plant.delay > LATE * period
        self.second = bode_fit.fit(exact, 2)
        best = bode_fit.fit(exact, order, zeros, late) if order > 2 else self.second
        self.theta = theta.suggest(exact, self.second, best, u_max)

        delay, m = plant.delay if late else 0.0, plant.magnet
        # Friction of a valve with solenoids, apart from its play; of a linear one the law learns it.
        rubbing = None if m is None else Friction(m.coulomb, m.presliding, m.gain, m.offset, 0)
        sides = None
        if m is not None:
            sides = first_gains.Magnet(m.coil, 0.5 * m.hysteresis, m.positive / m.negative - 1.0)
        whole = first_gains.KnownValve(
            model=plant.model,
            delay=delay,
            theta=self.theta,
            lvdt=Lvdt(rest.noise, rest.resolution),
            period=period,
            u_max=u_max,
            friction=rubbing,
            sensor_delay=sensor_delay,
            magnet=sides,
        )
        gains, notes = first_gains.first(whole), list[str]()
        if law in gains.refusals and any(p.name == f"{law}.denominator" for p in CONTROLLER):
            gains, notes = _simpler(exact, whole, law, gains.refusals[law])
        self.gains = gains.values
        self.notes = (*notes, *gains.notes, *dead_time.notes(delay, sensor_delay))


def _simpler(
    exact: Response, whole: first_gains.KnownValve, law: str, refusal: str
) -> tuple[first_gains.FirstGains, list[str]]:
    """First gains of ``law``, which takes no model of the form of ``whole``, with one of lower order; a note.

    It is a third order without zeros, or has zeros far away that cannot be inverted, or too much dead time.
    Raises ParameterError.
    """
    reason = refusal
    for lower in range(max(2, len(whole.model.denominator) - 2), 1, -1):
        try:
            simpler = bode_fit.fit(exact, lower, None, True, MOST_DELAY * whole.period)
        except ParameterError as error:
            reason = str(error)
            continue
        if np.max(np.abs(np.roots(simpler.model.numerator)), initial=0.0) > math.pi / whole.period:
            continue  # a zero that is not in the data
        gains = first_gains.first(whole._replace(model=simpler.model, delay=simpler.delay), whole)
        if law not in gains.refusals:
            note = (
                f"{law} gets a model of order {lower} with {1e3 * simpler.delay:.2g} ms of dead time, "
                f"because {refusal}"
            )
            return gains, [note]
        reason = gains.refusals[law]
    raise ParameterError(f"{law} gets no model: {reason}")


def controller_values(known: Known, law: str) -> Values:
    """First gains and model of ``law``, and the estimates by which readings are compared with the voltage.

    With the limits of the reference, where those of the D3FXE do not fit the valve.
    """
    own = {name: value for name, value in known.gains.items() if name.startswith((f"{law}.", "reshaping."))}
    estimates = {
        "arc.theta_initial": list(known.theta.initial),
        "arc.theta_min": list(known.theta.lower),
        "arc.theta_max": list(known.theta.upper),
    }
    return {**estimates, **own}


def box(plant: Plant, period: float, wider: float = 1.0, sensor_delay: float = 0.0) -> list[Quantity]:
    """What one valve may be from day to day, around what was found; ``wider``: times as far as usual.

    ``sensor_delay`` [s]: what of the dead time of a valve with solenoids is the sensor's.
    """
    behind = plant.delay if plant.magnet is None else min(plant.delay, sensor_delay)
    spread, rubbing, shift = wider * SPREAD, wider * RUBBING, wider * OFFSET
    friction, offset = plant.friction.coulomb, max(-9.0, min(9.0, plant.offset))
    quantities = [
        Quantity("gain", 1.0 - spread, 1.0 + spread, "-"),
        Quantity("speed", 1.0 - spread, 1.0 + spread, "-"),
        Quantity("disturbance.offset", offset - shift, offset + shift, "V"),
        Quantity("lvdt.delay", behind, behind + wider * LATER * period, "s"),
    ]
    if friction > 0.0:
        low, high = (1.0 - rubbing) * friction, (1.0 + rubbing) * friction
        quantities.append(Quantity("friction.coulomb", low, high, "V"))
    return quantities


def motions(plant: Plant, known: Known, limits: SafetyLimits, period: float) -> list[TuningMotion]:
    """Strokes and a sine, as fast as the valve can follow within ``limits``. Raises ParameterError."""
    left, weaker = DRIVEN * limits.voltage - plant.friction.coulomb - abs(plant.offset), 1.0
    if plant.magnet is not None:
        left -= 0.5 * plant.magnet.hysteresis + max(0.0, plant.magnet.overlap)
        weaker = min(plant.magnet.positive, plant.magnet.negative)
    height = min(ROOM * limits.travel, STATIC * left * weaker * abs(plant.model.static_gain))
    if height <= 0.0:
        raise ParameterError(
            "friction, hysteresis, overlap and offset take up the limit of the voltage, "
            f"{limits.voltage:g} V, so that no motion can be tuned on"
        )
    b0, a1, a0 = (float(v) for v in known.second.values[:3])

    def need(wanted: Floats) -> float:
        rate = np.gradient(wanted, period)
        return float(np.max(np.abs(np.gradient(rate, period) + a1 * rate + a0 * wanted))) / b0

    possible = list[TuningMotion]()
    for name, shape, size, slowest in (("strokes", _strokes, 1.0, 0.1), ("sine", _sine, SINE, 0.5)):
        tried = (shape(size * height, float(quick), period) for quick in np.geomspace(20.0, slowest, 40))
        possible += islice((TuningMotion(name, wanted) for wanted in tried if need(wanted) <= left), 1)
    if not possible:
        raise ParameterError("no motion can be found that the valve follows within the limit of the voltage")
    return possible


def _strokes(height: float, velocity: float, period: float) -> Floats:
    """There and back to either side, with a pause after each stroke."""
    acceleration = ACCELERATION * velocity
    ramp, cruise, _ = scenarios.stroke_time(height, velocity, acceleration)
    half = 2.0 * ramp + cruise + PAUSE
    shape = scenarios.strokes(height, velocity, acceleration, 2.0 * half)
    there = sampled(shape, period, max(2, round(2.0 * half / period)))
    return np.concatenate([there, -there])


def _sine(height: float, frequency: float, period: float) -> Floats:
    """Whole cycles that begin and end softly."""
    cycles = max(3, math.ceil(LONG * frequency))
    n = round(cycles / (frequency * period))
    time = np.arange(n) * period
    ends = np.clip(np.minimum(time, time[-1] - time) * frequency, 0.0, 1.0)
    wave: Floats = height * ends * np.sin(2.0 * np.pi * frequency * time)
    return wave
