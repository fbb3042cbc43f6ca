# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Evaluates the tests: rest, noise, static gain, friction, dead zone, and response without friction."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from valve_control.arrays import Floats
from valve_control.control.commands import scenarios
from valve_control.design.commissioning.bench import Record, SafetyLimits
from valve_control.design.commissioning.courses import REACH
from valve_control.design.identification import bode_fit, lvdt, response
from valve_control.design.identification import friction as rubbing
from valve_control.design.identification.bode_fit import Fit
from valve_control.design.identification.experiment import Experiment
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError

WINDOW = 0.02  # s  over which readings are averaged
SLIDING = 0.2  # of the stroke after a turn, from which on the spool is taken to slide
MOVED = 0.03  # of the stroke, from which on it has moved after a turn ...
DEVIATIONS = 5.0  # ... and times the noise of the averaged reading
LEAST_STROKE = 0.1  # V
ROUNDING = 1e-9  # V  of a mean voltage
HELD = 3.0  # times as large as in motion: the most that friction at rest is believed to be
FIRST, LAST, STEPS = 0.8, 100.0, 20  # Hz, Hz, -
HIGHEST = 0.2  # of the sampling frequency
CYCLES, STEP_TIME = 3, 0.8  # -, s  least length of a step
SETTLE = 0.25  # s  of each, left out
FILLED = 0.9  # of the travel at which a course turns round, that the lowest frequency may take
SLIDES = 1.4  # times the friction, which a sine needs at least
ROUNDS = 3  # of friction and lag
# Orders beside the second, and their zeros: a lag of solenoid or amplifier has none.
HIGHER = ((3, 0), (4, 2))
RICHER = ((3, 1), (4, 1))  # that are tried where none of these explains the readings


class Rest(NamedTuple):
    """The valve at 0 V."""

    position: float  # V
    noise: float  # V  standard deviation
    resolution: float  # V  step of the converter; 0.0: none


class Static(NamedTuple):
    """The valve in slow motion: u = y/gain + offset ± friction."""

    gain: float  # V/V
    offset: float  # V  that holds the spool at 0 V
    friction: float  # V  in motion, with what motion at this rate needs anyway
    rate: float  # V/s  of the voltage
    dead_zone: float  # V  by which the voltage changes after a turn until the spool moves
    stroke: float  # V  of the reading
    residual: float  # V  rms, of the voltage


def at_rest(record: Record) -> Rest:
    """Position, noise and resolution of a ``record`` at 0 V. Raises ParameterError."""
    known = record.reading[np.isfinite(record.reading)]
    if len(known) < lvdt.WINDOW:
        raise ParameterError(f"only {len(known)} readings came at rest; at least {lvdt.WINDOW} are needed")
    noise, resolution = lvdt.observe(record.reading)
    return Rest(float(np.mean(known)), noise, resolution)


def slow(record: Record, rest: Rest) -> Static:
    """Static gain, friction and dead zone from the slow triangle of a ``record``. Raises ParameterError."""
    width = max(1, round(WINDOW / record.period))
    parts = record.parts()
    reading, voltage = (
        np.concatenate([_averaged(signal, width) for signal in signals])
        for signals in ([part.reading for part in parts], [part.voltage for part in parts])
    )
    stroke = float(np.ptp(reading))
    if stroke < LEAST_STROKE:
        raise ParameterError(
            f"the spool moved by {stroke:.2g} V alone under {float(np.max(np.abs(voltage))):.3g} V; give a "
            "higher limit of the voltage or of the travel"
        )
    if float(np.sum((reading - np.mean(reading)) * (voltage - np.mean(voltage)))) <= 0.0:
        raise ParameterError(
            "the spool moves against the voltage; turn the sign of one of them before anything else"
        )
    turns = [begin + _turns(part.voltage) for begin, part in zip(record.begins, parts, strict=True)]
    rows, sides, zones = [], [], []
    least = max(MOVED * stroke, DEVIATIONS * (rest.noise + rest.resolution) / np.sqrt(width))
    for first, end in (leg for ends in turns for leg in pairwise(ends.tolist())):
        side = float(np.sign(voltage[end] - voltage[first]))
        moved = side * (reading[first : end + 1] - reading[first])
        # The averaged turn itself reaches a little beyond both of its sides.
        moving = np.flatnonzero(moved > moved[: width + 1].min() + least)
        if len(moving):
            zones.append(abs(float(voltage[first + moving[0]] - record.voltage[first])))
        beyond = np.flatnonzero(moved > SLIDING * stroke)
        if len(beyond) == 0:
            continue
        chosen = np.arange(first + beyond[0], end - width, width)
        rows.append(np.column_stack([reading[chosen], voltage[chosen]]))
        sides.append(np.full(len(chosen), side))
    if len({side for part in sides for side in part[:1]}) < 2:
        raise ParameterError("the spool slid to one side alone: the computer is busy or the voltage too low")
    data, side_of = np.concatenate(rows), np.concatenate(sides)
    matrix = np.column_stack([data[:, 0], np.ones(len(data)), side_of])
    (slope, offset, friction), *_ = np.linalg.lstsq(matrix, data[:, 1], rcond=None)
    residual = data[:, 1] - matrix @ np.array([slope, offset, friction])
    steps = np.abs(
        np.concatenate([np.diff(record.voltage[ends[0] : ends[-1] + 1]) for ends in turns if len(ends)])
    )
    return Static(
        gain=1.0 / float(slope),
        offset=float(offset),
        friction=max(0.0, float(friction)),
        rate=float(np.sum(steps)) / (record.period * max(1, len(steps))),
        dead_zone=float(np.median(zones)) if zones else 0.0,
        stroke=stroke,
        residual=float(np.sqrt(np.mean(residual**2))),
    )


class Friction(NamedTuple):
    """Friction as voltage."""

    coulomb: float  # V  in motion
    static_ratio: float  # -  at rest, over that


def friction_proper(static: Static, lag: float, rest: Rest) -> Friction:
    """Friction proper, without what a valve with the ``lag`` [s] needs to move at the triangle's rate."""
    coulomb = max(0.0, static.friction - static.rate * lag)
    if coulomb < max(rest.noise, rest.resolution):
        return Friction(0.0, 1.0)
    held = static.dead_zone - coulomb - static.rate * lag
    return Friction(coulomb, min(HELD, max(1.0, held / coulomb)))


class SinePlan(NamedTuple):
    """The stepped sine."""

    steps: tuple[scenarios.Step, ...]
    amplitude: float  # V
    offset: float  # V


def plan(limits: SafetyLimits, static: Static, period: float) -> SinePlan:
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
    return SinePlan(scenarios.sine_steps(FIRST, last, STEPS, CYCLES, STEP_TIME), amplitude, offset)


def measured(record: Record, planned: SinePlan, friction: float) -> Response:
    """Response of the valve itself in a ``record`` of the sine, without Coulomb ``friction`` [V].

    Raises ParameterError if nothing can be used.
    """
    steps = response.segments_of(planned.steps, record.period)
    segments = tuple(segment for segment in steps if segment.end <= len(record.reading))
    if not segments:
        raise ParameterError("the stepped sine ended before its first frequency was over")
    tested = Experiment("sine", record.period, record.voltage, record.reading, segments, math.inf, ())
    sliding = rubbing.without(tested, rubbing.Friction(friction, 0.0, 1.0, 0.0, 0))
    whole, found = (
        response.stepped(one.voltage, one.position, segments, record.period, SETTLE)
        for one in (tested, sliding)
    )
    return rubbing.unsure(found, whole)


def linear(
    sine: Record, planned: SinePlan, static: Static, rest: Rest, tell: Callable[[], None] = lambda: None
) -> tuple[Response, list[Fit], Friction]:
    """Response without friction, its fits, and friction without the valve's own lag.

    ``tell`` is called before each fit. Raises ParameterError.
    """
    friction = Friction(static.friction, 1.0)
    for _ in range(ROUNDS):
        tell()
        response = measured(sine, planned, friction.coulomb)
        second = bode_fit.fit(response, 2)
        lag = second.model.denominator[1] / second.model.denominator[2] + second.delay
        friction = friction_proper(static, lag, rest)
    fits, notes = higher(response, HIGHER, tell)
    return response._replace(notes=(*response.notes, *notes)), [second, *fits], friction


def higher(
    measured: Response, forms: Sequence[tuple[int, int]], tell: Callable[[], None] = lambda: None
) -> tuple[list[Fit], list[str]]:
    """Fits of the ``forms`` (order, zeros) that the ``measured`` response allows, and why not the others."""
    fits, notes = list[Fit](), list[str]()
    for order, zeros in forms:
        tell()
        try:
            fits.append(bode_fit.fit(measured, order, zeros))
        except ParameterError as error:
            notes.append(f"no model of order {order}: {error}")
    return fits, notes


def _turns(voltage: Floats) -> npt.NDArray[np.int64]:
    """Samples at which a triangle turns, the last one being its end."""
    steps = np.diff(voltage)
    steps = np.sign(np.where(np.abs(steps) > ROUNDING, steps, 0.0))
    moving = np.flatnonzero(steps)
    if len(moving) == 0:
        return np.zeros(0, dtype=np.int64)
    changes = moving[1:][steps[moving[1:]] != steps[moving[:-1]]]
    return np.concatenate([changes, moving[-1:] + 1]).astype(np.int64)


def _averaged(signal: Floats, width: int) -> Floats:
    """Mean over ``width`` samples of a ``signal``, whose gaps are filled."""
    known = np.flatnonzero(np.isfinite(signal))
    filled = np.interp(np.arange(len(signal)), known, signal[known])
    return np.asarray(scipy.ndimage.uniform_filter1d(filled, width, mode="nearest"))
