"""Where voltages and readings come from: a test of the simulated valve, or a bag."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.bags.errors import BagError
from valve_control.identification import response
from valve_control.identification.response import Response, Segment
from valve_control.parameters import build
from valve_control.parameters.table import COMMAND, CONTROLLER, ParameterError, Values, updated
from valve_control.recordings.parameters import Node
from valve_control.recordings.recording import Recording, Valve, align
from valve_control.simulation import offline, scenarios

Floats = npt.NDArray[np.float64]
DEFAULTS = {"scenario": "stepped_sine", "frequency": 0.5, "end_frequency": 100.0, "sweep_time": 60.0}
ROOM = 0.4  # times the sampling frequency, above which no frequency is tried unasked
STILL = 1e-6  # V within which a voltage does not move
LOOSE = 0.5  # of a sine's amplitude that jitter of a wall clock may leave
MARGIN = 0.01  # s by which a schedule may be late
FEEDBACK = ("arc", "oarc", "pid")
LONGEST = 50_000_000  # samples
STUCK = 0.005  # V/V, a response that no moving spool stays below
SPAN = 5.0  # highest over lowest frequency that a model needs at least
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


def simulated(controller: Values, valve: Values, command: Values, motion: Floats | None = None) -> Experiment:
    """The valve driven by the command source's shape as voltage, or by ``motion`` [V], without feedback.

    Raises ParameterError.
    """
    open_loop = updated(
        CONTROLLER,
        controller,
        {"controller": "open_loop", "open_loop.static_gain": 1.0, "command_limit": 100.0},
    )
    _check_stable(valve)
    period = build.number(valve, "sample_period")
    segments: tuple[Segment, ...] = ()
    if motion is None:
        highest = _highest(command)
        if highest >= 0.5 / period:
            raise ParameterError(
                f"{highest:g} Hz is not below Nyquist's frequency, {0.5 / period:g} Hz at a sample period of "
                f"{period:g} s"
            )
        motion = offline.commands(command)
    if command["scenario"] == "stepped_sine":
        shape = build.shape(command)
        segments = tuple(
            Segment(
                math.ceil((shape.start + step.start) / period - 1e-9),
                min(len(motion), math.floor((shape.start + step.end) / period + 1e-9)),
                step.frequency,
            )
            for step in scenarios.steps_of(shape)
        )
    u_max = build.number(open_loop, "u_max")
    largest = float(np.max(np.abs(motion)))
    if largest >= u_max:
        raise ParameterError(
            f"the test reaches {largest:g} V and would saturate at u_max, {u_max:g} V; "
            "choose a smaller amplitude"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        run = offline.simulate(open_loop, valve, motion)
    if not np.all(np.abs(run.measurement) <= DIVERGED * u_max):
        raise ParameterError(
            "the position runs away, so the valve has no frequency response without feedback"
        )
    source = f"{command['scenario']}, up to {largest:.3g} V, {len(motion) * period:.4g} s"
    return Experiment(
        f"simulated valve ({source})", period, run.voltage, run.measurement, segments, u_max, ()
    )


def _check_stable(values: Values) -> None:
    """Raise ParameterError for a valve that cannot be tested without feedback."""
    model = build.valve_model(values)
    # Flow force feeds the position back to the input.
    feedback = build.number(values, "flow_force")
    poles = np.roots(np.polyadd(model.denominator, feedback * np.asarray(model.numerator)))
    worst = poles[np.argmax(poles.real)]
    if worst.real >= -1e-9 * abs(worst):
        raise ParameterError(
            f"the valve is unstable (a pole at {worst:.3g} rad/s), so it has no frequency response without "
            "feedback"
        )


def test_values(given: dict[str, object], period: float) -> Values:
    """Values of the command source for a test: what was ``given``, and a length that holds all of it."""
    base: dict[str, object] = {**DEFAULTS, "end_frequency": min(100.0, ROOM / period)}
    values = {p.name: p.default for p in COMMAND}
    values = updated(COMMAND, values, {**base, "duration": 1e6, **given})
    start = build.number(values, "start")
    if "duration" in given:
        needed, duration = start + build.number(values, "sweep_time"), build.number(values, "duration")
        if values["scenario"] == "sweep" and duration < needed:
            raise ParameterError(f"duration is {duration:g} s; the sweep takes {needed:.4g} s (sweep_time)")
        return values
    if values["scenario"] == "stepped_sine":
        length = scenarios.steps_of(build.shape(values))[-1].end
    elif values["scenario"] == "sweep":
        length = build.number(values, "sweep_time")
    else:
        length = 60.0
    if start + length > LONGEST * period:
        raise ParameterError(f"the test takes {start + length:.4g} s, which is more than {LONGEST} samples")
    return updated(COMMAND, values, {"duration": start + length})


def _highest(command: Values) -> float:
    names = {"sine": ("frequency",), "sweep": ("frequency", "end_frequency")}
    names["stepped_sine"] = names["sweep"]
    scenario = build.word(command, "scenario")
    return max((build.number(command, name) for name in names.get(scenario, ())), default=0.0)


def recorded(recording: Recording, valve: Valve) -> Experiment:
    """Voltages and readings of a recorded test of ``valve``. Raises BagError."""
    for part in ("spool_position", "valve_voltage"):
        if part not in valve.signals or len(valve.signals[part].time) == 0:
            raise BagError(
                f"{valve.name} has no {part}, which identification needs; --map says what plays its part"
            )
    aligned = align(valve)
    notes = []
    count = len(aligned.time)
    sequence = valve.signals["spool_position"].sequence[-count:]
    index = np.arange(count)
    steps = np.diff(sequence)
    if len(steps) and np.all(steps > 0) and sequence[-1] - sequence[0] < 2 * count:
        index = sequence - sequence[0]
    elif len(steps):
        notes.append("the readings have no numbers, so lost ones cannot be told")
    length = int(index[-1]) + 1
    voltage, position, time = (np.full(length, np.nan) for _ in range(3))
    voltage[index], position[index], time[index] = aligned.voltage, aligned.measurement, aligned.time
    if length > count:
        notes.append(f"{length - count} of {length} readings were lost and are left out")
        known = np.isfinite(time)
        time = np.interp(np.arange(length), np.flatnonzero(known), time[known])
    period = aligned.period
    rate = (time[-1] - time[0]) / max(1, length - 1)
    if not 0.98 * period < rate < 1.02 * period:
        notes.append(f"the readings came every {1e3 * rate:.4g} ms, not every {1e3 * period:.4g} ms as told")
        period = float(rate)
    held = _held(voltage)
    segments = _scheduled(_source(recording, valve), held, time, period)
    if not segments:
        segments = response.find_segments(held, period)
    controller = valve.controller
    told = {} if controller is None else controller.initial
    u_max = float(told.get("u_max", 10.0))
    law = str(told.get("controller", "open_loop"))
    if law in FEEDBACK:
        notes.append(
            f"the voltage came from {law}, which feeds noise of the reading back: the response is biased"
        )
    return Experiment(
        f"{recording.bag.path.name}: {valve.name}",
        period,
        voltage,
        position,
        tuple(segments),
        u_max,
        tuple(notes),
    )


def _held(signal: Floats) -> Floats:
    """``signal`` with its last value before each gap held over it."""
    known = np.where(np.isfinite(signal), np.arange(len(signal)), 0)
    return signal[np.maximum.accumulate(known)]


def _source(recording: Recording, valve: Valve) -> Node | None:
    for node in recording.nodes.values():
        if node.kind == "command_source" and node.namespace == valve.topics.namespace:
            return node
    return None


def _scheduled(source: Node | None, voltage: Floats, time: Floats, period: float) -> list[Segment]:
    """Segments of the stepped sine that the command source's recorded parameters tell; empty if none."""
    if source is None:
        return []
    told = dict(source.initial)
    for change in source.changes:
        told.update(change.values)
    values, _ = source.table_values(told)
    moving = np.flatnonzero(np.abs(voltage - voltage[0]) > STILL)
    if values["scenario"] != "stepped_sine" or len(moving) == 0:
        return []
    begin = time[max(0, int(moving[0]) - 1)]
    found = []
    for step in scenarios.steps_of(build.shape(values)):
        first, end = np.searchsorted(time, [begin + step.start, begin + step.end - MARGIN])
        if end - first < 8 or step.frequency * period >= 0.5:
            continue
        exact = response.refined(voltage, int(first), int(end), step.frequency * period, period, LOOSE)
        if exact is None or abs(exact.frequency / step.frequency - 1.0) > response.SAME:
            return []
        found.append(exact)
    return found


def estimate(experiment: Experiment, settle: float, band: tuple[float, float] | None) -> Response:
    """Response of the valve in an experiment; ``band`` [Hz] limits it. Raises ParameterError."""
    measured = _estimate(experiment, settle, band)
    largest = float(np.max(np.abs(measured.value)))
    if largest < STUCK:
        raise ParameterError(
            f"the spool hardly moves, by at most {largest:.2g} V per volt; is the amplitude too small for "
            "its friction?"
        )
    lowest, highest = float(measured.frequency[0]), float(measured.frequency[-1])
    if highest < SPAN * lowest:
        raise ParameterError(
            f"the response is known from {lowest:.4g} to {highest:.4g} Hz alone; a model needs them over "
            f"{SPAN:g}:1 at least"
        )
    return measured


def _estimate(experiment: Experiment, settle: float, band: tuple[float, float] | None) -> Response:
    held = _held(experiment.voltage)
    response.check_saturation(held[np.isfinite(held)], experiment.u_max)
    if not np.any(np.abs(held - held[0]) > STILL):
        raise ParameterError("the voltage does not move, so there is no excitation")
    if experiment.segments:
        segments = [s for s in experiment.segments if band is None or band[0] <= s.frequency <= band[1]]
        if not segments:
            raise ParameterError(f"no frequency of the test lies between {band[0]:g} and {band[1]:g} Hz")  # type: ignore[index]
        return response.stepped(experiment.voltage, experiment.position, segments, experiment.period, settle)
    low, high = band or (DEFAULTS["frequency"], min(100.0, ROOM / experiment.period))
    assert isinstance(low, float) and isinstance(high, float)
    known = np.flatnonzero(np.isfinite(experiment.position))
    position = np.interp(np.arange(len(held)), known, experiment.position[known])
    return response.spectral(held, position, experiment.period, low, high)
