# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tests a valve: excites it with voltages, takes its readings, and estimates the frequency response."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.commands import scenarios
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND, CONTROLLER
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.control.simulation import offline
from valve_control.design.identification import response
from valve_control.design.identification.response import Response, Segment
from valve_control.parameter import ParameterError, Values, defaults, number, updated

DEFAULTS = {"scenario": "stepped_sine", "frequency": 0.5, "end_frequency": 100.0, "sweep_time": 60.0}
ROOM = 0.4  # times the sampling frequency, above which no frequency is tried unasked
SPAN = 5.0  # highest over lowest frequency that a model needs at least
HELD_TRAVEL = 0.1  # V, and
HELD_GAIN = 0.25  # V/V, below both of which a spool may be held by friction: its bristles give a few 0.01 V
SAMPLES = 20.0  # in a period of a valve's natural frequency, where holding the voltage costs 9° of phase
BRIDGED = 5  # samples in a row that are not known and are filled in
LEAST_STRETCH = 100  # samples
# Windows that are looked at for feedback, their samples, the older ones that count, the delays of a law.
MOST_WINDOWS, WINDOW, PAST, FEEDBACK_LAGS = 100, 400, 6, 4
ALIKE = 0.3  # mean correlation from which on there is feedback
NEW = 1e-6  # of the voltage, below which nothing in it is new
DIVERGED = 1e3  # times u_max, beyond which a position has run away


class Experiment(NamedTuple):
    """Voltages [V] and readings [V], sample by sample; NaN where a reading was lost."""

    source: str
    period: float  # s
    voltage: Floats
    position: Floats
    segments: tuple[Segment, ...]  # stretches of one frequency; empty: any motion
    u_max: float  # V
    notes: tuple[str, ...]
    feedback: str = ""  # the law that the voltage came from, if it looks at the reading
    command: Floats | None = None  # V  NaN where it is not known
    leaps: tuple[int, ...] = ()  # samples before which time leaps

    @property
    def excitation(self) -> Floats:
        """What moves the valve whatever it reads [V]: the voltage, or under feedback the command."""
        return self.command if self.feedback and self.command is not None else self.voltage


def simulated(controller: Values, valve: Values, command: Values, motion: Floats | None = None) -> Experiment:
    """Simulate a test: the command source's shape, or ``motion`` [V], is the voltage, without feedback.

    Raises ParameterError.
    """
    open_loop = updated(
        CONTROLLER,
        controller,
        {"controller": "open_loop", "open_loop.static_gain": 1.0, "command_limit": 100.0},
    )
    period = number(valve, "sample_period")
    segments: tuple[Segment, ...] = ()
    if motion is None:
        motion = build.commands(command)
    if command["scenario"] == "stepped_sine":
        shape = build.shape(command)
        whole = response.segments_of(scenarios.steps_of(shape), period, shape.start)
        segments = tuple(s._replace(end=min(len(motion), s.end)) for s in whole)
    u_max = number(open_loop, "u_max")
    with np.errstate(over="ignore", invalid="ignore"):
        run = offline.simulate(open_loop, valve, motion, alone=True)
    model = build.valve_model(valve)  # to whose input flow force feeds the position back
    poles = np.roots(np.polyadd(model.denominator, number(valve, "flow_force") * np.array(model.numerator)))
    if np.any(poles.real >= -1e-9 * np.abs(poles)) or not np.all(np.abs(run.measurement) <= DIVERGED * u_max):
        raise ParameterError(
            "the position runs away: the valve is unstable and has no frequency response without feedback"
        )
    source = f"{command['scenario']}, up to {np.max(np.abs(motion)):.3g} V, {len(motion) * period:.4g} s"
    source = f"simulated valve ({source})"
    return Experiment(source, period, run.voltage, run.measurement, segments, u_max, ())


def test_values(changes: dict[str, object], period: float) -> Values:
    """Values of the command source for a test with ``changes``, and a duration that holds all of it."""
    base = {**DEFAULTS, "end_frequency": min(100.0, ROOM / period), "duration": 1e6}
    values = updated(COMMAND, defaults(COMMAND), {**base, **changes})
    if "duration" in changes:
        return values
    length = 60.0
    if values["scenario"] == "stepped_sine":
        length = scenarios.steps_of(build.shape(values))[-1].end
    elif values["scenario"] == "sweep":
        length = number(values, "sweep_time")
    elif values["scenario"] == "triangle":
        length = number(values, "cycles") / number(values, "frequency")
    duration = number(values, "start") + length
    build.check_memory(duration / period)
    return updated(COMMAND, values, {"duration": duration})


def held(signal: Floats) -> Floats:
    """Copy of ``signal`` in which the last value before each gap fills the gap."""
    known = np.where(np.isfinite(signal), np.arange(len(signal)), 0)
    return signal[np.maximum.accumulate(known)]


def excited(tested: Experiment) -> Experiment:
    """A recorded test with its stretches of one frequency, and feedback that its signals show.

    Raises ParameterError if feedback has nothing that moves the valve independently of the reading.
    """
    if not tested.feedback and feeds_back(tested.voltage, tested.position):
        tested = tested._replace(feedback="the voltage depends on the reading")
    moved = tested.excitation[np.isfinite(tested.excitation)]
    if tested.feedback and (tested.command is None or not len(moved) or np.ptp(moved) == 0.0):
        raise ParameterError(
            f"{tested.source} was recorded under feedback ({tested.feedback}) and has no command that moves, "
            "without which voltage and reading do not show the valve; name it (--map spool_command=…), or "
            "record a stepped sine or sweep with controller open_loop"
        )
    bounds = (0, *tested.leaps, len(tested.voltage))
    segments = [
        segment._replace(first=segment.first + a, end=segment.end + a)
        for a, b in pairwise(bounds)
        for segment in response.find_segments(held(tested.excitation[a:b]), tested.period)
    ]
    return tested._replace(segments=tuple(segments))


def feeds_back(voltage: Floats, position: Floats) -> bool:
    """Whether a ``voltage`` [V] follows from the readings ``position`` [V]; NaN: not known.

    A reading has news that older readings and voltages do not tell (its innovation, by regression in each
    window). Without feedback the news of the voltage are independent of them; under feedback they follow from
    them, up to FEEDBACK_LAGS samples later.
    """
    known = np.isfinite(voltage) & np.isfinite(position)
    firsts = np.linspace(0, len(known) - WINDOW, min(MOST_WINDOWS, len(known) // WINDOW)).astype(int)
    parts = [slice(first, first + WINDOW) for first in firsts if np.all(known[first : first + WINDOW])]
    alike = [[_alike(voltage[p], position[p], lag) for lag in range(FEEDBACK_LAGS)] for p in parts]
    moved = [window for window in alike if any(window)]
    return bool(moved) and bool(np.max(np.abs(np.mean(moved, axis=0))) > ALIKE)


def _alike(voltage: Floats, position: Floats, lag: int) -> float:
    """Correlation of the news in a ``voltage`` and in the ``position`` ``lag`` samples before; 0.0: none."""
    n = len(voltage) - lag - PAST
    before = [voltage[i : i + n] for i in range(lag + PAST)] + [position[i : i + n] for i in range(PAST)]
    columns = np.column_stack([np.ones(n), *before])
    both = np.column_stack([voltage[lag + PAST :], position[PAST : PAST + n]])
    fit, _, _, _ = np.linalg.lstsq(columns, both, rcond=None)
    u, y = (both - columns @ fit).T
    size = math.sqrt(float(u @ u) * float(y @ y))
    news = size > 0.0 and float(u @ u) > NEW**2 * n * float(np.mean(np.square(voltage)))
    return float(u @ y) / size if news else 0.0


def stretches(tested: Experiment) -> list[Floats]:
    """Excitation, voltage and position [V], 3×samples, of each stretch without a leap of time or a long gap.

    Up to BRIDGED samples that are not known are bridged; what comes before the first voltage tells nothing.
    """
    rows = np.stack([held(tested.excitation), held(tested.voltage), tested.position])
    known = np.flatnonzero(np.all(np.isfinite(rows), axis=0) & np.isfinite(tested.voltage))
    part, found = np.searchsorted(tested.leaps, known, side="right"), []
    for k in np.split(known, np.flatnonzero((np.diff(known) > BRIDGED + 1) | (np.diff(part) > 0)) + 1):
        if len(k) > LEAST_STRETCH:
            whole = np.arange(k[0], k[-1] + 1)
            found.append(np.vstack([rows[:2, whole], np.interp(whole, k, tested.position[k])]))
    if not found:
        raise ParameterError(f"{tested.source} has no stretch of readings and voltages without a gap")
    return found


def estimate(experiment: Experiment, settle: float, band: tuple[float, float] | None) -> Response:
    """Frequency response of the valve in an experiment; ``band`` [Hz] limits it. Raises ParameterError."""
    period = experiment.period
    at_limit = int(np.count_nonzero(np.abs(experiment.voltage) >= experiment.u_max * (1.0 - 1e-12)))
    if at_limit and not experiment.feedback:  # what then drove the valve is unknown
        raise ParameterError(
            f"the voltage is at its limit of {experiment.u_max:g} V in {at_limit} of "
            f"{len(experiment.voltage)} samples; choose a smaller amplitude"
        )
    whole = (0.0, math.inf) if experiment.segments else (0.5, min(100.0, ROOM / period))
    low, high = band or whole
    if experiment.segments:
        segments = [s for s in experiment.segments if low <= s.frequency <= high]
        if not segments:
            raise ParameterError(f"no frequency of the test lies between {low:g} and {high:g} Hz")
        measured = response.stepped(experiment.voltage, experiment.position, segments, period, settle)
    else:
        measured = response.spectral(stretches(experiment), period, low, high)
    # A spool that friction holds answers as a stiffer valve would, linear and with narrow bounds; by its
    # response alone it cannot be told from one.
    largest = float(np.max(np.abs(measured.value)))
    amplitude = 0.5 * float(np.nanmax(experiment.voltage) - np.nanmin(experiment.voltage))
    if largest < HELD_GAIN and largest * amplitude < HELD_TRAVEL:
        raise ParameterError(
            f"{amplitude:.3g} V moved the spool by {largest * amplitude:.2g} V alone, which is what friction "
            "gives while it holds a spool; test with a larger amplitude"
        )
    lowest, highest = float(measured.frequency[0]), float(measured.frequency[-1])
    if highest < SPAN * lowest:
        reasons = "; ".join(measured.notes) or "the test has no other frequencies"
        raise ParameterError(
            f"the response is known from {lowest:.4g} to {highest:.4g} Hz alone, and a model needs it over "
            f"{SPAN:g}:1 at least: {reasons}; {response.NEXT}"
        )
    return measured


def period_notes(period: float, second: TransferFunction) -> list[str]:
    """A sentence if the sample ``period`` [s] is too long for the valve, a model of the ``second`` order."""
    natural = math.sqrt(max(0.0, second.denominator[-1])) / (2.0 * math.pi)
    if natural * period * SAMPLES <= 1.0:
        return []
    return [
        f"the sample period of {1e3 * period:.4g} ms is too long for this valve with its natural frequency "
        f"of {natural:.3g} Hz; {1e3 / (SAMPLES * natural):.2g} ms is the longest that its model and gains "
        "can be relied on with"
    ]
