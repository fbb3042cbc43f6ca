# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tests a valve: excites it with voltages, takes its readings, and estimates the frequency response."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.analysis.timing import Spread
from valve_control.control.commands import scenarios
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND, CONTROLLER
from valve_control.control.simulation import offline
from valve_control.design.identification import response
from valve_control.design.identification.rational import Fit
from valve_control.design.identification.response import Response, Segment
from valve_control.parameter import ParameterError, Values, defaults, number, updated

DEFAULTS = {"scenario": "stepped_sine", "frequency": 0.5, "end_frequency": 100.0, "sweep_time": 60.0}
ROOM = 0.4  # times the sampling frequency, above which no frequency is tried unasked
LONGEST = 50_000_000  # samples
SPAN = 5.0  # highest over lowest frequency that a model needs at least
HELD_TRAVEL = 0.1  # V, and
HELD_GAIN = 0.25  # V/V, below both of which a spool may be held by friction: its bristles give a few 0.01 V
SAMPLES = 20.0  # in a period of a valve's natural frequency, where holding the voltage costs 9° of phase
INCOHERENT = 0.9  # coherence below which a frequency is named
NAMED = 5  # frequencies, at most
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
    times: "RecordedTimes | None" = None  # of a recorded test whose stamps tell them


class RecordedTimes(NamedTuple):
    """What the times of the messages of a recorded test tell, sample by sample."""

    voltage: Floats  # V  mean until the next reading: a driver applies a voltage when it comes
    late: npt.NDArray[np.bool_]  # readings
    way: Spread  # s  from a reading to its voltage


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
    if duration > LONGEST * period:
        raise ParameterError(f"the test takes {duration:.4g} s, which is more than {LONGEST} samples")
    return updated(COMMAND, values, {"duration": duration})


def held(signal: Floats) -> Floats:
    """Copy of ``signal`` in which the last value before each gap fills the gap."""
    known = np.where(np.isfinite(signal), np.arange(len(signal)), 0)
    return signal[np.maximum.accumulate(known)]


def estimate(experiment: Experiment, settle: float, band: tuple[float, float] | None) -> Response:
    """Frequency response of the valve in an experiment; ``band`` [Hz] limits it. Raises ParameterError."""
    voltage, position, period = held(experiment.voltage), experiment.position, experiment.period
    begin = int(np.argmax(np.isfinite(voltage)))  # readings before the first voltage tell nothing
    voltage, position = voltage[begin:], position[begin:]
    at_limit = int(np.count_nonzero(np.abs(voltage) >= experiment.u_max * (1.0 - 1e-12)))
    if at_limit:  # what then drove the valve is unknown
        raise ParameterError(
            f"the voltage is at its limit of {experiment.u_max:g} V in {at_limit} of {len(voltage)} samples; "
            "choose a smaller amplitude"
        )
    whole = (0.0, math.inf) if experiment.segments else (0.5, min(100.0, ROOM / period))
    low, high = band or whole
    if experiment.segments:
        segments = [s for s in experiment.segments if low <= s.frequency <= high]
        if not segments:
            raise ParameterError(f"no frequency of the test lies between {low:g} and {high:g} Hz")
        measured = response.stepped(experiment.voltage, experiment.position, segments, period, settle)
    else:
        known = np.flatnonzero(np.isfinite(position))
        if not len(known):
            raise ParameterError("no reading came after the first voltage")
        position = np.interp(np.arange(len(voltage)), known, position[known])
        measured = response.spectral(voltage, position, period, low, high)
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
        raise ParameterError(
            f"the response is known from {lowest:.4g} to {highest:.4g} Hz alone; a model needs them over "
            f"{SPAN:g}:1 at least"
        )
    return measured


def coherence_notes(measured: Response) -> list[str]:
    """Frequencies at which much of the motion is not the voltage's, as a sentence."""
    weak = np.flatnonzero(measured.coherence < INCOHERENT)
    if len(weak) == 0:
        return []
    worst = sorted(weak[np.argsort(measured.coherence[weak], kind="stable")[:NAMED]])
    named = ", ".join(f"{measured.frequency[i]:.3g} Hz ({measured.coherence[i]:.3f})" for i in worst)
    more = f" and {len(weak) - len(worst)} more" if len(weak) > len(worst) else ""
    return [
        f"coherence below {INCOHERENT:g} at {named}{more}: noise, friction or another motion makes more than "
        f"{100.0 * (1.0 - INCOHERENT):.0f} % of the power of the position there; a larger amplitude or a "
        "longer test tells more"
    ]


def period_notes(period: float, second: Fit) -> list[str]:
    """A sentence if the sample ``period`` [s] is too long for the valve of the ``second`` order."""
    natural = math.sqrt(max(0.0, second.model.denominator[-1])) / (2.0 * math.pi)
    if natural * period * SAMPLES <= 1.0:
        return []
    return [
        f"the sample period of {1e3 * period:.4g} ms is too long for this valve with its natural frequency "
        f"of {natural:.3g} Hz; {1e3 / (SAMPLES * natural):.2g} ms is the longest that its model and gains "
        "can be relied on with"
    ]
