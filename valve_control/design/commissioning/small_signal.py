# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Plans the stepped sine, and takes friction out of the response that it gives.

Coulomb friction F answers a sine of the position Y with a square wave against its velocity, whose first
harmonic is 4F/π. So the valve itself was driven by U - (4F/π)·j·Y/|Y| instead of U, as long as it slides
(describing function, e.g. A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions, 1968).
"""

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.commands import scenarios
from valve_control.design.commissioning import statics
from valve_control.design.commissioning.bench import Record, SafetyLimits
from valve_control.design.commissioning.courses import REACH
from valve_control.design.commissioning.statics import Friction, Rest, Static
from valve_control.design.identification import rational, response
from valve_control.design.identification.rational import Fit
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError

FIRST, LAST, STEPS = 0.8, 100.0, 20  # Hz, Hz, -
HIGHEST = 0.2  # of the sampling frequency
CYCLES, STEP_TIME = 3, 0.8  # -, s  least length of a step
SETTLE = 0.25  # s  of each, left out
FILLED = 0.9  # of the travel at which a course turns round, that the lowest frequency may take
SLIDES = 1.4  # times the friction, which a sine needs at least
DRIVEN = 0.25  # of a sine's amplitude, that must be left for the valve itself
UNSURE = 0.05  # relative uncertainty of the friction
ROUNDS = 3  # of friction and lag
# Orders beside the second, and their zeros: a lag of solenoid or amplifier has none.
HIGHER = ((3, 0), (4, 2))
RICHER = ((3, 1), (4, 1))  # that are tried where none of these explains the readings


class Plan(NamedTuple):
    """The stepped sine."""

    steps: tuple[scenarios.Step, ...]
    amplitude: float  # V
    offset: float  # V


def plan(limits: SafetyLimits, static: Static, period: float) -> Plan:
    """The largest sine within the limits: friction bends the response of a small one.

    Raises ParameterError.
    """
    offset = max(-0.5 * limits.voltage, min(0.5 * limits.voltage, static.offset))
    by_travel = FILLED * REACH * limits.travel / static.gain + static.friction
    amplitude = min(limits.voltage - abs(offset), by_travel)
    if amplitude < SLIDES * static.friction:
        raise ParameterError(
            f"friction is {static.friction:.3g} V; a sine that moves the spool needs "
            f"{SLIDES * static.friction:.3g} V at least, and within the limits there are {amplitude:.3g} V"
        )
    last = min(LAST, HIGHEST / period)
    return Plan(scenarios.sine_steps(FIRST, last, STEPS, CYCLES, STEP_TIME), amplitude, offset)


def measured(record: Record, planned: Plan, friction: float) -> Response:
    """Response of the valve itself in a ``record`` of the sine, without ``friction`` [V].

    Raises ParameterError if nothing can be used.
    """
    segments = [
        segment
        for segment in response.segments_of(planned.steps, record.period)
        if segment.end <= len(record.reading)
    ]
    if not segments:
        raise ParameterError("the stepped sine ended before its first frequency was over")
    whole = response.stepped(record.voltage, record.reading, segments, record.period, SETTLE)
    amplitudes = []
    for frequency in whole.frequency:
        segment = min(segments, key=lambda s: abs(s.frequency - frequency))
        settled = segment.first + round(SETTLE / record.period)
        amplitudes.append(math.sqrt(2.0) * float(np.std(record.voltage[settled : segment.end])))
    return _without(whole, np.array(amplitudes), friction)


def linear(
    sine: Record, planned: Plan, static: Static, rest: Rest, tell: Callable[[], None] = lambda: None
) -> tuple[Response, list[Fit], Friction]:
    """Response without friction, its fits, and friction without the valve's own lag.

    ``tell`` is called before each fit. Raises ParameterError.
    """
    friction = Friction(static.friction, 1.0)
    for _ in range(ROUNDS):
        tell()
        response = measured(sine, planned, friction.coulomb)
        second = rational.fit(response, 2)
        lag = second.model.denominator[1] / second.model.denominator[2] + second.delay
        friction = statics.friction(static, lag, rest)
    fits = [second]
    for order, zeros in HIGHER:
        tell()
        try:
            fits.append(rational.fit(response, order, zeros))
        except ParameterError as error:
            response = response._replace(notes=(*response.notes, f"no model of order {order}: {error}"))
    return response, fits, friction


def richer(measured: Response) -> list[Fit]:
    """Fits of the forms RICHER, those that the ``measured`` response allows."""
    fits = []
    for order, zeros in RICHER:
        with contextlib.suppress(ParameterError):
            fits.append(rational.fit(measured, order, zeros))
    return fits


def _without(whole: Response, amplitude: Floats, friction: float) -> Response:
    """The ``whole`` response without ``friction`` [V]; ``amplitude`` [V], n: of each frequency's sine."""
    level = 4.0 * friction / math.pi
    direction = whole.value / np.abs(whole.value)
    left = amplitude - 1j * level * direction
    usable = np.abs(left) > DRIVEN * amplitude
    notes = list(whole.notes)
    if not np.any(usable):
        raise ParameterError(
            f"friction of {friction:.3g} V takes up the sine; give a higher limit of the voltage"
        )
    if not np.all(usable):
        notes.append(
            f"{int(np.count_nonzero(~usable))} frequencies are left out: friction takes up their sine"
        )
    value = whole.value * amplitude / left
    size = np.abs(value)
    unsure = UNSURE * level / np.abs(left) * size
    deviation = np.hypot(whole.deviation * size / np.abs(whole.value), unsure)
    return whole._replace(
        frequency=whole.frequency[usable],
        value=value[usable],
        deviation=deviation[usable],
        coherence=whole.coherence[usable],
        notes=tuple(notes),
    )
