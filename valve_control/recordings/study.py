"""What a recording tells: quality of its samples, indices of each part, estimates, V2, spectra."""

import datetime
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.analysis.indices import Indices, indices
from valve_control.analysis.segments import Segment, motions
from valve_control.analysis.spectra import Spectrum, spectrum
from valve_control.analysis.timing import Timing, spread, timing
from valve_control.bags.errors import BagError
from valve_control.recordings.cleaning import seconds
from valve_control.recordings.parameters import Change
from valve_control.recordings.recording import ESTIMATES, Aligned, Recording, State, Valve, align, at_time

Floats = npt.NDArray[np.float64]
NONE = Indices(np.nan, np.nan, np.nan, np.nan, np.nan)


class Part(NamedTuple):
    """One segment of a run with its indices."""

    segment: Segment
    controller: str
    indices: Indices
    change: str  # what was changed at its beginning, "" if nothing


class ValveStudy(NamedTuple):
    """Results for one valve."""

    valve: Valve
    signals: Aligned | None  # None without readings
    timing: dict[str, Timing]  # by part
    recorded_after: dict[str, Any]  # spread of the time [s] from publication to recording, by part
    controller: str  # "" if unknown
    parts: list[Part]  # the first is the whole run
    error_spectrum: Spectrum
    voltage_spectrum: Spectrum
    left_out: list[str]


class Study(NamedTuple):
    """Results for a bag."""

    recording: Recording
    valves: dict[str, ValveStudy]
    left_out: list[str]


def study(recording: Recording) -> Study:
    """Analyse what can be analysed; what cannot is said in ``left_out``."""
    return Study(
        recording,
        {name: _study_valve(valve) for name, valve in recording.valves.items()},
        list(recording.problems),
    )


def _study_valve(valve: Valve) -> ValveStudy:
    left_out = list(valve.problems)
    signals = None
    try:
        signals = align(valve)
    except BagError as reason:
        left_out.append(str(reason))
    times = {part: timing(s.time, s.sequence) for part, s in valve.timed.items()}
    recorded_after = {
        part: spread(seconds(s.log_time, s.time))._asdict()
        for part, s in valve.signals.items()
        if s.has_source_time and len(s.time)
    }
    name = controller_name(valve)
    parts: list[Part] = []
    empty = Spectrum(np.empty(0), np.empty(0))
    error_spectrum = voltage_spectrum = empty
    if signals is not None and len(signals.time) > 1:
        parts = _parts(valve, signals, name)
        if times["spool_position"].gaps and not valve.lockstep:
            left_out.append(f"{valve.name}: spectra take the readings as evenly spaced, over gaps too")
        error = signals.measurement - signals.command
        if np.all(np.isfinite(error)):
            error_spectrum = spectrum(error, signals.period)
        if np.all(np.isfinite(signals.voltage)):
            voltage_spectrum = spectrum(signals.voltage, signals.period)
    return ValveStudy(
        valve, signals, times, recorded_after, name, parts, error_spectrum, voltage_spectrum, left_out
    )


def controller_name(valve: Valve) -> str:
    """Law at the beginning of the recording: from the parameters, else from the names of its terms."""
    if valve.controller is not None and "controller" in valve.controller.initial:
        return str(valve.controller.initial["controller"])
    labels = set(valve.state.labels) if valve.state is not None else set()
    if "virtual_control" in labels:
        return "oarc"
    if "lyapunov" in labels:
        return "arc"
    return "pid" if "integral_voltage" in labels else ""


def segment_indices(signals: Aligned, segment: Segment) -> Indices:
    """I1-I5 of a segment; NaN for those whose signal the bag does not have."""
    inside = slice(segment.start, segment.end)
    error = (signals.measurement - signals.command)[inside]
    voltage = signals.voltage[inside]
    if len(error) == 0:
        return NONE
    has_error, has_voltage = bool(np.all(np.isfinite(error))), bool(np.all(np.isfinite(voltage)))
    zeros = np.zeros(len(error))
    got = indices(error if has_error else zeros, voltage if has_voltage else zeros, signals.period)
    if not has_error:
        got = got._replace(e_M=np.nan, e_F=np.nan, e_rms=np.nan)
    return got if has_voltage else got._replace(u_rms=np.nan, c_u=np.nan)


def _parts(valve: Valve, signals: Aligned, name: str) -> list[Part]:
    count = len(signals.time)
    segments = [(Segment("run", "whole run", 0, count), "")]
    if np.all(np.isfinite(signals.command)):
        segments += [(segment, "") for segment in motions(signals.command, signals.period)]
    changes = valve.controller.changes if valve.controller is not None else []
    starts = [int(np.searchsorted(signals.stamp, change.time)) for change in changes]
    if any(0 < start < count for start in starts):
        edges = [0, *starts, count]
        texts = ["", *map(change_text, changes)]
        for i, text in enumerate(texts):
            segment = Segment(
                "parameters", f"after change {i}" if i else "before changes", edges[i], edges[i + 1]
            )
            if segment.end > segment.start:
                segments.append((segment, text))
    return [
        Part(segment, _law_at(name, changes, int(signals.stamp[segment.start])), values, text)
        for segment, text in segments
        for values in (segment_indices(signals, segment),)
    ]


def _law_at(name: str, changes: list[Change], stamp: int) -> str:
    for change in changes:
        if change.time <= stamp and "controller" in change.values:
            name = str(change.values["controller"])
    return name


def change_text(change: Change) -> str:
    """A change of parameters in words."""
    return ", ".join(f"{name} = {value}" for name, value in change.values.items())


def estimates(state: State | None) -> dict[str, Floats]:
    """θ̂ over time, {} if the law has none."""
    if state is None:
        return {}
    found = {name: state.values[name] for name in ESTIMATES}
    return {name: values for name, values in found.items() if np.any(np.isfinite(values))}


def guarantee_use(state: State | None) -> float | None:
    """Largest V2 over its guaranteed bound at the same time, None if the law has none."""
    if state is None:
        return None
    bound = state.values["lyapunov_bound"]
    usable = np.isfinite(bound) & (bound > 0.0) & np.isfinite(state.values["lyapunov"])
    return float(np.max(state.values["lyapunov"][usable] / bound[usable])) if usable.any() else None


def about_bag(result: Study) -> dict[str, Any]:
    """What the bag is, for JSON."""
    bag = result.recording.bag
    stamps = [s.log_time for v in result.recording.valves.values() for s in v.signals.values() if len(s.time)]
    begin, end = min(int(s.min()) for s in stamps), max(int(s.max()) for s in stamps)
    return {
        "path": str(bag.path),
        "storage": bag.storage,
        "compression": bag.compression or None,
        "files": bag.files,
        "bytes": bag.size,
        "version": bag.version,
        "distribution": bag.distribution or None,
        "start": datetime.datetime.fromtimestamp(begin * 1e-9, datetime.UTC).isoformat(),
        "duration_s": (end - begin) * 1e-9,
        "topics": {name: topic.type for name, topic in sorted(bag.topics.items())},
    }


def as_dict(result: Study) -> dict[str, Any]:
    """The whole study for JSON."""
    return {
        "bag": about_bag(result),
        "valves": {name: _valve_dict(valve) for name, valve in result.valves.items()},
        "left_out": result.left_out,
    }


def _valve_dict(result: ValveStudy) -> dict[str, Any]:
    valve, signals = result.valve, result.signals
    theta = estimates(valve.state)
    nodes = [node for node in (valve.controller, valve.simulator) if node is not None]
    return {
        "controller": result.controller or None,
        "sample_period_s": signals.period if signals is not None else None,
        "sources": {part: str(source) for part, source in valve.topics.sources.items()},
        "indices": result.parts[0].indices._asdict() if result.parts else None,
        "segments": [_part_dict(part, signals) for part in result.parts if signals is not None],
        "timing": {
            part: {**entry._asdict(), "jitter_s": entry.jitter_s._asdict()}
            for part, entry in result.timing.items()
        },
        "latency_s": spread(signals.latency)._asdict() if signals is not None else None,
        "unanswered": signals.unanswered if signals is not None else None,
        "recorded_after_s": result.recorded_after,
        "theta": [float(values[np.isfinite(values)][-1]) for values in theta.values()] if theta else None,
        "lyapunov_over_bound": guarantee_use(valve.state),
        "parameters": {node.name: {"kind": node.kind, "initial": node.initial} for node in nodes},
        "changes": [
            {"time_s": _since(change.time, signals), "node": node.name, "values": change.values}
            for node in nodes
            for change in node.changes
        ],
        "left_out": result.left_out,
    }


def _since(stamp: int, signals: Aligned | None) -> float | None:
    return None if signals is None else at_time(signals, stamp)


def _part_dict(part: Part, signals: Aligned) -> dict[str, Any]:
    segment = part.segment
    return {
        "kind": segment.kind,
        "name": segment.name,
        "start_s": float(signals.time[segment.start]),
        "end_s": float(signals.time[segment.end - 1]),
        "samples": segment.end - segment.start,
        "controller": part.controller or None,
        "change": part.change or None,
        "indices": part.indices._asdict(),
    }
