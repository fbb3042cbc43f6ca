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
from valve_control.control.analysis.timing import (
    DEVIATION,
    Timing,
    lost_messages,
    spread,
    timing,
    true_period,
    without_intervals,
)
from valve_control.control.laws.registry import LAWS
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.cleaning import seconds
from valve_control.recordings.clocks import shared
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

EPOCH = 10**17  # ns; a table whose times begin before it (1973) has its own zero
NONE = Indices(np.nan, np.nan, np.nan, np.nan, np.nan)


class Part(NamedTuple):
    """One segment of a run, with its indices."""

    segment: Segment
    controller: str
    indices: Indices
    change: str  # what was changed at its beginning, "" if nothing
    time_in: dict[str, float]  # s, by each mode but ok that there was
    without_safe: Indices  # of what is not safe (nor inactive or unknown); NONE where nothing is left
    only_ok: Indices  # likewise, of what is ok


class Spell(NamedTuple):
    """Stretch of time [s] in which the controller was in one mode."""

    interval: Interval
    start: float  # s
    end: float  # s
    samples: int  # of the run
    listed: bool  # whether the run has anything of it


class Period(NamedTuple):
    """Period of the LVDT readings, compared with the controller's."""

    measured: float  # s, NaN if there are too few readings, or in lockstep
    wanted: float | None  # s, sample_period at the beginning, None if it is not recorded
    differs: bool  # by more than jitter and lost readings explain


class ValveAnalysis(NamedTuple):
    """Results for one valve."""

    valve: ValveRecording
    signals: Aligned | None  # None without readings
    timing: dict[str, Timing]  # by part
    recorded_after: dict[str, Any]  # spread of the time [s] from publication to recording, by part
    controller: str  # "" if unknown
    parts: list[Part]  # the first is the whole run
    spells: list[Spell]  # of all modes; [] if they are not known
    period: Period
    error_spectrum: Spectrum
    voltage_spectrum: Spectrum
    spectra_notes: list[str]  # those of the notes that are about the spectra
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
    recorded_after = {
        part: spread(seconds(s.log_time, s.time))._asdict()
        for part, s in valve.signals.items()
        if valve.clock.source and not valve.coarse and not shared(s.log_time) and len(s.time)
    }
    name = controller_name(valve)
    parts: list[Part] = []
    spells: list[Spell] = []
    spectra_notes: list[str] = []
    measured = _period(valve)
    empty = Spectrum(np.empty(0), np.empty(0))
    error_spectrum = voltage_spectrum = empty
    if signals is not None and len(signals.time) > 1:
        period = measured.measured if measured.differs else signals.period
        if measured.differs and measured.wanted:
            spectra_notes.append(
                f"{valve.name}: LVDT readings come every {1e3 * measured.measured:.4g} ms, sample_period is "
                f"{1e3 * measured.wanted:.4g} ms; motions, e_F and spectra reckon with {1e3 * period:.4g} ms"
            )
        told = of_samples(valve.modes, signals.stamp, signals.period) if valve.modes else None
        spells = _spells(valve.modes, signals, told)
        modes = None if told is None else np.array([part.mode for part in valve.modes])[told]
        parts = _parts(valve, signals, name, period, modes)
        if times["spool_position"].gaps and not valve.lockstep:
            spectra_notes.append(f"{valve.name}: spectra take the readings as evenly spaced, over gaps too")
        left_out += spectra_notes
        error = signals.measurement - signals.command
        if np.all(np.isfinite(error)):
            error_spectrum = spectrum(error, period)
        if np.all(np.isfinite(signals.voltage)):
            voltage_spectrum = spectrum(signals.voltage, period)
    return ValveAnalysis(
        valve=valve,
        signals=signals,
        timing=times,
        recorded_after=recorded_after,
        controller=name,
        parts=parts,
        spells=spells,
        period=measured,
        error_spectrum=error_spectrum,
        voltage_spectrum=voltage_spectrum,
        spectra_notes=spectra_notes,
        left_out=left_out,
    )


def _period(valve: ValveRecording) -> Period:
    """Measure the period of the readings up to the first change of sample_period."""
    wanted, changes = None, []
    if valve.controller is not None and "sample_period" in valve.controller.initial:
        wanted = float(valve.controller.initial["sample_period"])
        changes = [change.time for change in valve.controller.changes if "sample_period" in change.values]
    readings = valve.recorded.get("spool_position")
    if valve.lockstep or readings is None:
        return Period(np.nan, wanted, False)
    count = int(np.searchsorted(readings.time, changes[0])) if changes else len(readings.time)
    time, sequence = readings.time[: count or None], readings.sequence[: count or None]
    measured = true_period(time, sequence)
    if wanted is None or not np.isfinite(measured):
        return Period(measured, wanted, False)
    # Without numbers losses look like a longer period; they leave the usual interval as it is.
    usual = measured if lost_messages(sequence) is not None else float(np.median(np.diff(time))) * 1e-9
    away, usually_away = measured / wanted - 1.0, usual / wanted - 1.0
    return Period(measured, wanted, abs(away) > DEVIATION and usually_away * np.sign(away) > 0.5 * abs(away))


def _spells(modes: list[Interval], signals: Aligned, told: npt.NDArray[np.int64] | None) -> list[Spell]:
    if told is None:
        return []
    counts = np.bincount(told, minlength=len(modes)).tolist()
    answered = int(signals.stamp[0]) + round(signals.period * 1e9)
    return [
        Spell(part, at_time(signals, part.start), at_time(signals, part.end), count, count > 0 or late)
        for part, count in zip(modes, counts, strict=True)
        for late in (part.end > answered,)
    ]


def controller_name(valve: ValveRecording) -> str:
    """Name of the law at the beginning: from the parameters, else from the names of its terms."""
    if valve.controller is not None and "controller" in valve.controller.initial:
        return str(valve.controller.initial["controller"])
    labels = set(valve.state.labels) if valve.state is not None else set()
    matching = [law for law in LAWS.values() if law.feedback and set(law.term_labels) <= labels]
    return max(matching, key=lambda law: len(law.term_labels)).name if matching else ""


def segment_indices(
    signals: Aligned,
    segment: Segment,
    period: float | None = None,
    kept: npt.NDArray[np.bool_] | None = None,
) -> Indices:
    """I1-I5 of a segment, or of those of its samples that are ``kept``; NaN for what the bag does not have.

    ``period`` [s] is that of the readings, if it is not the recorded one.
    """
    inside = slice(segment.start, segment.end)
    error = (signals.measurement - signals.command)[inside]
    voltage = signals.voltage[inside]
    if len(error) == 0 or (kept is not None and not kept.any()):
        return NONE
    has_error, has_voltage = bool(np.all(np.isfinite(error))), bool(np.all(np.isfinite(voltage)))
    zeros = np.zeros(len(error))
    got = indices(
        error if has_error else zeros,
        voltage if has_voltage else zeros,
        signals.period if period is None else period,
        kept,
        signals.time[inside],
    )
    if not has_error:
        got = got._replace(e_M=np.nan, e_F=np.nan, e_rms=np.nan)
    return got if has_voltage else got._replace(u_rms=np.nan, c_u=np.nan)


def _parts(
    valve: ValveRecording, signals: Aligned, name: str, period: float, modes: npt.NDArray[np.int64] | None
) -> list[Part]:
    count = len(signals.time)
    segments = [(Segment("run", "whole run", 0, count), "")]
    if np.all(np.isfinite(signals.command)):
        segments += [(segment, "") for segment in motions(signals.command, period)]
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
    return [_part(signals, segment, text, name, changes, period, modes) for segment, text in segments]


def _part(
    signals: Aligned,
    segment: Segment,
    change: str,
    name: str,
    changes: list[Change],
    period: float,
    modes: npt.NDArray[np.int64] | None,
) -> Part:
    whole = segment_indices(signals, segment, period)
    time_in: dict[str, float] = {}
    kept = [whole, whole]
    if modes is not None:
        inside = modes[segment.start : segment.end]
        times = signals.time[segment.start : segment.end + 1]
        if segment.end == len(signals.time):
            times = np.append(times, times[-1] + period)
        lasts = np.diff(times)
        others = [mode for mode in Mode if mode is not Mode.OK and np.any(inside == mode)]
        time_in = {mode.name.lower(): float(np.sum(lasts[inside == mode])) for mode in others}
        if time_in:
            kept = [segment_indices(signals, segment, period, inside <= m) for m in (Mode.DEGRADED, Mode.OK)]
    law = _law_at(name, changes, int(signals.stamp[segment.start]))
    return Part(segment, law, whole, change, time_in, *kept)


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
        "version": bag.version,
        "distribution": bag.distribution or None,
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


def _valve_dict(result: ValveAnalysis) -> dict[str, Any]:
    valve, signals = result.valve, result.signals
    theta = estimates(valve.state)
    return {
        "controller": result.controller or None,
        "sample_period_s": signals.period if signals is not None else None,
        "sources": {part: str(source) for part, source in valve.topics.sources.items()},
        "indices": result.parts[0].indices._asdict() if result.parts else None,
        "segments": [_part_dict(part, signals) for part in result.parts if signals is not None],
        "modes": modes_dict(result),
        "lvdt_period": _period_dict(result.period),
        "timing": {
            part: {**entry._asdict(), "jitter_s": entry.jitter_s._asdict()}
            for part, entry in result.timing.items()
        },
        "latency_s": spread(signals.latency)._asdict() if signals is not None else None,
        "unanswered": signals.unanswered if signals is not None else None,
        "recorded_after_s": result.recorded_after,
        "theta": [float(values[np.isfinite(values)][-1]) for values in theta.values()] if theta else None,
        "lyapunov_over_bound": guarantee_use(valve.state),
        "parameters": {node.name: {"kind": node.kind, "initial": node.initial} for node in result.nodes},
        "changes": [
            {"time_s": _since(change.time, signals), "node": node.name, "values": change.values}
            for node in result.nodes
            for change in node.changes
        ],
        "left_out": result.left_out,
    }


def modes_dict(result: ValveAnalysis) -> dict[str, Any] | None:
    """Modes of the run for JSON, None if they are not known."""
    if not result.spells:
        return None
    run = result.parts[0]
    listed = [spell for spell in result.spells if spell.listed]
    total = max(listed[-1].end, 0.0) if listed else 0.0
    about: dict[str, Any] = {}
    for mode in Mode:
        own = [spell for spell in listed if spell.interval.mode is mode]
        duration = sum(spell.end - max(spell.start, 0.0) for spell in own)
        about[mode.name.lower()] = {
            "intervals": len(own),
            "duration_s": duration,
            "share": duration / total if total > 0.0 else None,
            "samples": sum(spell.samples for spell in own),
        }
    about["intervals"] = [
        {
            "mode": spell.interval.mode.name.lower(),
            "start_s": spell.start,
            "end_s": spell.end,
            "duration_s": spell.end - spell.start,
            "samples": spell.samples,
            "reasons": list(spell.interval.reasons),
        }
        for spell in result.spells
        if spell.interval.mode is not Mode.OK
    ]
    about["indices_without_safe"] = run.without_safe._asdict()
    about["indices_only_ok"] = run.only_ok._asdict()
    return about


def _period_dict(period: Period) -> dict[str, Any]:
    return {
        "measured_s": period.measured,
        "sample_period_s": period.wanted,
        "deviation": period.measured / period.wanted - 1.0
        if period.wanted and np.isfinite(period.measured)
        else None,
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
        "not_ok_s": part.time_in,
        "indices_without_safe": part.without_safe._asdict(),
        "indices_only_ok": part.only_ok._asdict(),
    }
