# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Analyses a recording: regularity of the samples, indices of each part, estimates, V2, spectra."""

import datetime
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.analysis.indices import Indices, indices
from valve_control.control.analysis.segments import Segment, motions
from valve_control.control.analysis.spectra import Spectrum, spectrum
from valve_control.control.analysis.timing import Timing, spread, timing, without_intervals
from valve_control.control.laws.registry import LAWS
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.modes import Interval, Mode, of_samples
from valve_control.recordings.parameters import Change, Node
from valve_control.recordings.recording import (
    ESTIMATES,
    Aligned,
    Recording,
    State,
    ValveRecording,
    align,
    at_time,
)
from valve_control.recordings.report import plain

EPOCH = 10**17  # ns; a table whose times begin before it (1973) has its own zero
NONE = Indices(np.nan, np.nan, np.nan, np.nan, np.nan)


class Part(NamedTuple):
    """One segment of a run with its indices, as in JSON."""

    kind: str  # run, motion or parameters
    name: str
    start_s: float
    end_s: float  # of the last sample
    samples: int
    controller: str | None
    change: str | None  # what was changed at its beginning
    indices: Indices
    not_ok_s: dict[str, float]  # by each mode but ok that there was
    indices_only_ok: Indices  # of what is ok; NONE where nothing is left


class Spell(NamedTuple):
    """Stretch of time in which the controller was in one mode, as in JSON."""

    mode: Mode
    start_s: float
    end_s: float
    duration_s: float
    samples: int  # of the run
    reasons: tuple[str, ...]
    listed: bool  # whether the run has anything of it


class ValveAnalysis(NamedTuple):
    """Results for one valve."""

    valve: ValveRecording
    signals: Aligned | None  # None without readings
    timing: dict[str, Timing]  # by part
    controller: str  # "" if unknown
    parts: list[Part]  # the first is the whole run
    spells: list[Spell]  # of all modes; [] if they are not known
    error_spectrum: Spectrum
    voltage_spectrum: Spectrum
    left_out: list[str]

    @property
    def nodes(self) -> list[Node]:
        """Controller and simulator, as far as they were recorded."""
        return [node for node in (self.valve.controller, self.valve.simulator) if node is not None]


class Analysis(NamedTuple):
    """Results for a bag."""

    recording: Recording
    valves: dict[str, ValveAnalysis]
    left_out: list[str]


def analyze(recording: Recording) -> Analysis:
    """Analyse a recording; what cannot be analysed is named in ``left_out``."""
    return Analysis(
        recording,
        {name: _analyze_valve(valve) for name, valve in recording.valves.items()},
        list(recording.problems),
    )


def _analyze_valve(valve: ValveRecording) -> ValveAnalysis:
    left_out = list(valve.problems)
    signals = None
    try:
        signals = align(valve)
    except BagError as reason:
        left_out.append(str(reason))
    times = {part: timing(s.time, s.sequence) for part, s in valve.recorded.items()}
    if valve.coarse:
        times = {part: without_intervals(entry) for part, entry in times.items()}
    name = controller_name(valve)
    parts: list[Part] = []
    spells: list[Spell] = []
    empty = Spectrum(np.empty(0), np.empty(0))
    of_error = of_voltage = empty
    if signals is not None and len(signals.time) > 1:
        modes = None
        if valve.modes:
            interval = of_samples(valve.modes, signals.stamp, signals.period)
            spells = _spells(valve.modes, signals, interval)
            modes = np.array([part.mode for part in valve.modes])[interval]
        parts = _parts(valve, signals, name, modes)
        if times["spool_position"].gaps and not valve.lockstep:
            left_out.append(f"{valve.name}: spectra take the readings as evenly spaced, over gaps too")
        both = (signals.measurement - signals.command, signals.voltage)
        of_error, of_voltage = (spectrum(s, signals.period) if np.isfinite(s).all() else empty for s in both)
    return ValveAnalysis(valve, signals, times, name, parts, spells, of_error, of_voltage, left_out)


def _spells(modes: list[Interval], signals: Aligned, interval: npt.NDArray[np.int64]) -> list[Spell]:
    counts = np.bincount(interval, minlength=len(modes)).tolist()
    answered = int(signals.stamp[0]) + round(signals.period * 1e9)
    spells = []
    for part, count in zip(modes, counts, strict=True):
        start, end = at_time(signals, part.start), at_time(signals, part.end)
        listed = count > 0 or part.end > answered
        spells.append(Spell(part.mode, start, end, end - start, count, part.reasons, listed))
    return spells


def controller_name(valve: ValveRecording) -> str:
    """Name of the law at the beginning: from the parameters, else from the names of its terms."""
    if valve.controller is not None and "controller" in valve.controller.initial:
        return str(valve.controller.initial["controller"])
    labels = set(valve.state.labels) if valve.state is not None else set()
    matching = [law for law in LAWS.values() if law.feedback and set(law.term_labels) <= labels]
    return max(matching, key=lambda law: len(law.term_labels)).name if matching else ""


def _segment_indices(
    signals: Aligned, segment: Segment, kept: npt.NDArray[np.bool_] | None = None
) -> Indices:
    """I1-I5 of a segment, or of its samples that are ``kept``; NaN for what the bag does not have."""
    inside = slice(segment.start, segment.end)
    error = (signals.measurement - signals.command)[inside]
    voltage = signals.voltage[inside]
    if len(error) == 0 or (kept is not None and not kept.any()):
        return NONE
    has_error, has_voltage = bool(np.all(np.isfinite(error))), bool(np.all(np.isfinite(voltage)))
    zeros = np.zeros(len(error))
    both = (error if has_error else zeros, voltage if has_voltage else zeros)
    got = indices(*both, signals.period, kept, signals.time[inside])
    if not has_error:
        got = got._replace(e_M=np.nan, e_F=np.nan, e_rms=np.nan)
    return got if has_voltage else got._replace(u_rms=np.nan, c_u=np.nan)


def _parts(
    valve: ValveRecording, signals: Aligned, name: str, modes: npt.NDArray[np.int64] | None
) -> list[Part]:
    count = len(signals.time)
    segments = [(Segment("run", "whole run", 0, count), "")]
    if np.all(np.isfinite(signals.command)):
        segments += [(segment, "") for segment in motions(signals.command, signals.period)]
    changes = valve.controller.changes if valve.controller is not None else []
    starts = [int(np.searchsorted(signals.stamp, change.time)) for change in changes]
    if any(0 < start < count for start in starts):
        since: list[str] = []
        texts = ["", *map(change_text, changes)]
        for i, (start, end) in enumerate(zip([0, *starts], [*starts, count], strict=True)):
            since += [texts[i]] if i else []
            if end > start:
                segment = Segment("parameters", f"after change {i}" if i else "before changes", start, end)
                segments.append((segment, "; ".join(since)))
                since = []

    lasts = np.diff(signals.time, append=signals.time[-1] + signals.period)

    def part(segment: Segment, change: str) -> Part:
        whole = only_ok = _segment_indices(signals, segment)
        time_in: dict[str, float] = {}
        if modes is not None:
            inside, within = modes[segment.start : segment.end], lasts[segment.start : segment.end]
            others = [mode for mode in Mode if mode is not Mode.OK and np.any(inside == mode)]
            time_in = {mode.name.lower(): float(np.sum(within[inside == mode])) for mode in others}
            if time_in:
                only_ok = _segment_indices(signals, segment, inside == Mode.OK)
        stamp, start = signals.stamp[segment.start], float(signals.time[segment.start])
        laws = [c.values["controller"] for c in changes if c.time <= stamp and "controller" in c.values]
        law = str(laws[-1]) if laws else name
        return Part(
            segment.kind, segment.name, start, float(signals.time[segment.end - 1]),
            segment.end - segment.start, law or None, change or None, whole, time_in, only_ok,
        )  # fmt: skip

    return [part(segment, text) for segment, text in segments]


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
    """Largest ratio of V2 to its guaranteed bound at the same time, None if the law has none."""
    if state is None:
        return None
    bound = state.values["lyapunov_bound"]
    usable = np.isfinite(bound) & (bound > 0.0) & np.isfinite(state.values["lyapunov"])
    return float(np.max(state.values["lyapunov"][usable] / bound[usable])) if usable.any() else None


def about_bag(result: Analysis) -> dict[str, Any]:
    """File, recorder and length of the bag, for JSON."""
    bag = result.recording.bag
    signals = [s for v in result.recording.valves.values() for s in v.signals.values() if len(s.time)]
    # Of a table the times of its rows, among which its commands and voltages have places of their own.
    stamps = [s.time if bag.table is None else s.log_time for s in signals]
    begin, end = min(int(s.min()) for s in stamps), max(int(s.max()) for s in stamps)
    return {
        "path": str(bag.path),
        "storage": bag.storage,
        "compression": bag.compression or None,
        "files": bag.files,
        "bytes": bag.size,
        "version": bag.listing.version,
        "distribution": bag.listing.distribution or None,
        "start": f"{begin * 1e-9:.6g} s"
        if bag.table is not None and begin < EPOCH
        else datetime.datetime.fromtimestamp(begin * 1e-9, datetime.UTC).isoformat(),
        "duration_s": (end - begin) * 1e-9,
        "clock": result.recording.clock.name,
        "topics": {name: topic.type for name, topic in sorted(bag.topics.items())},
    }


def as_dict(result: Analysis) -> dict[str, Any]:
    """The whole analysis for JSON."""
    return {
        "bag": about_bag(result),
        "valves": {name: _valve_dict(valve) for name, valve in result.valves.items()},
        "left_out": result.left_out,
    }


def _valve_dict(result: ValveAnalysis) -> Any:
    valve, signals = result.valve, result.signals
    theta = estimates(valve.state)
    return plain(
        {
            "controller": result.controller or None,
            "sample_period_s": signals.period if signals is not None else None,
            "sources": {part: str(source) for part, source in valve.topics.sources.items()},
            "indices": result.parts[0].indices if result.parts else None,
            "segments": result.parts,
            "modes": modes_dict(result),
            "timing": result.timing,
            "latency_s": spread(signals.latency) if signals is not None else None,
            "unanswered": signals.unanswered if signals is not None else None,
            "theta": [float(values[np.isfinite(values)][-1]) for values in theta.values()] if theta else None,
            "lyapunov_over_bound": guarantee_use(valve.state),
            "parameters": {node.name: {"kind": node.kind, "initial": node.initial} for node in result.nodes},
            "changes": [
                {
                    "time_s": None if signals is None else at_time(signals, change.time),
                    "node": node.name,
                    "values": change.values,
                }
                for node in result.nodes
                for change in node.changes
            ],
            "left_out": result.left_out,
        }
    )


def modes_dict(result: ValveAnalysis) -> dict[str, Any] | None:
    """Modes of the run for JSON, None if they are not known."""
    if not result.spells:
        return None
    run = result.parts[0]
    listed = [spell for spell in result.spells if spell.listed]
    total = max(listed[-1].end_s, 0.0) if listed else 0.0
    about: dict[str, Any] = {}
    for mode in Mode:
        own = [spell for spell in listed if spell.mode is mode]
        duration = sum(spell.end_s - max(spell.start_s, 0.0) for spell in own)
        about[mode.name.lower()] = {
            "intervals": len(own),
            "duration_s": duration,
            "share": duration / total if total > 0.0 else None,
            "samples": sum(spell.samples for spell in own),
        }
    spells = [spell for spell in result.spells if spell.mode is not Mode.OK]
    about["intervals"] = [
        dict(zip(Spell._fields[:-1], (spell.mode.name.lower(), *spell[1:-1]), strict=True))
        for spell in spells
    ]
    about["indices_only_ok"] = run.indices_only_ok
    return about
