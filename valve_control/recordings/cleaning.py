"""Puts the signals of a valve on one time base and leaves out readings that cannot be used."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.bags.bag import Series
from valve_control.recordings.mapping import Source

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
LEAD = ("spool_position", "valve_voltage", "spool_command")  # whose part is chosen where time was set back
SMALL_DISORDER = 0.1  # s by which messages may be out of order
CLOCK_STEPS = 3  # times that a clock may have been set back; more means a file that is not sorted
SAME_CLOCK = 1e-3  # s, or half a period, by which delays to the recorder may differ between topics
PIECES = 20  # of a recording
PROMPT = 10.0  # % of them in which one message at least is recorded at once
PUBLISHERS = 8  # that are told apart on one topic
BACKLOG = 1000  # numbers by which a publisher may have gone on


class Samples(NamedTuple):
    """One signal of a valve in order of time."""

    topic: str
    time: Integers  # ns, source time if the bag has it
    log_time: Integers  # ns, when it was recorded
    sent: Integers  # ns, by its publisher's clock; when it was recorded if the bag does not have it
    sequence: Integers
    value: Floats  # V
    has_source_time: bool

    def pick(self, chosen: Any) -> "Samples":
        """Some of the samples, by mask, slice or index."""
        return self._replace(
            time=self.time[chosen],
            log_time=self.log_time[chosen],
            sent=self.sent[chosen],
            sequence=self.sequence[chosen],
            value=self.value[chosen],
        )


class Cleaned(NamedTuple):
    """Signals by part: spool_command, spool_position, valve_voltage."""

    recorded: dict[str, Samples]  # everything
    timed: dict[str, Samples]  # of one publisher
    usable: dict[str, Samples]  # of one publisher, and finite


def seconds(stamp: Integers, begin: int | Integers = 0) -> Floats:
    """Time [s] from ``begin`` to ``stamp`` [ns]."""
    return (stamp - begin).astype(np.float64) * 1e-9


def clean(sources: Mapping[str, Source], series: Mapping[str, Series], problems: list[str]) -> Cleaned:
    """Put the signals of one valve on one time base; what is left out is named in ``problems``."""
    raw = {part: _samples(source, series[source.topic], problems) for part, source in sources.items()}
    raw = _in_order_of_recording(raw, problems)
    recorded = _on_one_clock(raw, problems)
    timed = {part: _one_publisher(samples, problems) for part, samples in recorded.items()}
    usable = {}
    for part, samples in timed.items():
        keep = np.isfinite(samples.value)
        if not keep.all():
            n = int(np.count_nonzero(~keep))
            problems.append(f"{n} messages of {samples.topic} hold NaN or infinity and are left out")
            samples = samples.pick(keep)
        usable[part] = samples
    return Cleaned(recorded, timed, usable)


def _samples(source: Source, series: Series, problems: list[str]) -> Samples:
    value = series.values[source.field]
    if source.factor != 1.0:
        value = value * source.factor
    if series.undecodable:
        problems.append(
            f"{series.undecodable} messages of {source.topic} could not be decoded and are left out: "
            f"{series.error}"
        )
    known = bool(np.any(series.publish_time != series.log_time))
    sent = series.publish_time
    return Samples(source.topic, sent, series.log_time, sent, series.sequence, value, known)


def _steps_back(time: Integers, least: float = SMALL_DISORDER) -> Integers:
    """Where ``time`` [ns] goes back by more than ``least`` [s]."""
    return np.flatnonzero(np.diff(time) < -round(least * 1e9))


def _in_order_of_recording(raw: dict[str, Samples], problems: list[str]) -> dict[str, Samples]:
    """Sort by log time; if the recorder's clock was set back, one part of all signals is kept."""
    steps = {part: _steps_back(samples.log_time) for part, samples in raw.items()}
    most = max((len(back) for back in steps.values()), default=0)
    if 0 < most <= CLOCK_STEPS:
        lead = next(part for part in LEAD if part in raw and len(steps[part]) == most)
        edges = [0, *(steps[lead] + 1).tolist(), len(raw[lead].log_time)]
        chosen = int(np.argmax(np.diff(edges)))
        kept = {}
        for part, samples in raw.items():
            if len(steps[part]) != most:
                problems.append(
                    f"{samples.topic} is left out: the clock of the recorder was set back {most} time(s), "
                    "which does not show on it"
                )
                kept[part] = samples.pick(slice(0, 0))
                continue
            own = [0, *(steps[part] + 1).tolist(), len(samples.log_time)]
            kept[part] = samples.pick(slice(own[chosen], own[chosen + 1]))
            problems.append(
                f"time of recording goes backwards on {samples.topic} {most} time(s); only part {chosen + 1} "
                f"is analysed ({len(kept[part].time)} of {len(samples.time)} messages)"
            )
        raw = kept
    ordered = {}
    for part, samples in raw.items():
        if np.any(np.diff(samples.log_time) < 0):
            if most > CLOCK_STEPS:
                problems.append(f"messages of {samples.topic} were not in order of time and are sorted")
            samples = samples.pick(np.argsort(samples.log_time, kind="stable"))
        ordered[part] = samples
    return ordered


def _on_one_clock(raw: dict[str, Samples], problems: list[str]) -> dict[str, Samples]:
    """Source times if all signals have them, in order and of one clock; else times of recording for all."""
    filled = [samples for samples in raw.values() if len(samples.time)]
    reason = ""
    if any(samples.has_source_time for samples in filled):
        without = [samples.topic for samples in filled if not samples.has_source_time]
        backwards = [samples.topic for samples in filled if len(_steps_back(samples.time))]
        delays = {s.topic: _delay(s) for s in filled}
        apart = max(delays.values()) - min(delays.values())
        intervals = [float(np.median(np.diff(s.time))) * 1e-9 for s in filled if len(s.time) > 1]
        limit = max(SAME_CLOCK, 0.5 * max(intervals, default=0.0))
        if without:
            reason = f"{', '.join(without)} has no source times"
        elif backwards:
            reason = f"source times go backwards on {', '.join(backwards)}"
        elif apart > limit:
            told = ", ".join(f"{topic} {1e3 * delay:.3g} ms" for topic, delay in delays.items())
            reason = f"the publishers' clocks differ (time until recorded: {told})"
    use_source = bool(filled) and not reason and any(samples.has_source_time for samples in filled)
    if reason:
        problems.append(f"{reason}; times of recording are used")
    result = {}
    for part, samples in raw.items():
        if use_source:
            disorder = int(np.count_nonzero(np.diff(samples.time) < 0))
            if disorder:
                problems.append(f"{disorder} messages of {samples.topic} were out of order and are sorted")
                samples = samples.pick(np.argsort(samples.time, kind="stable"))
        else:
            samples = samples._replace(time=samples.log_time, has_source_time=False)
        result[part] = samples
    return result


def _delay(samples: Samples) -> float:
    """Time [s] from publisher to recorder, with the difference of their clocks.

    The shortest of pieces in which messages were recorded at once; what waits for a busy recorder says
    nothing of clocks.
    """
    delays = seconds(samples.log_time, samples.time)
    shortest = [piece.min() for piece in np.array_split(delays, min(PIECES, len(delays)))]
    return float(np.percentile(shortest, PROMPT))


def _one_publisher(samples: Samples, problems: list[str]) -> Samples:
    """Messages of the publisher with the most, where several are interleaved, told apart by their numbers."""
    sequence = samples.sequence
    falls = int(np.count_nonzero(np.diff(sequence) <= 0)) if np.any(sequence) else 0
    if len(sequence) <= 20 or falls <= max(10, 0.02 * len(sequence)):
        return samples
    owner = _owners(sequence)
    if owner is None:
        problems.append(f"the numbers of {samples.topic} are not those of publishers and are not used")
        return samples._replace(sequence=np.zeros_like(sequence))
    counts = np.bincount(owner)
    most = int(np.argmax(counts))
    problems.append(
        f"{len(counts)} publishers are interleaved on {samples.topic}; only the one with the most messages "
        f"({counts[most]} of {len(sequence)}) is analysed"
    )
    return samples.pick(owner == most)


def _owners(sequence: Integers) -> Integers | None:
    """Publisher of each message: the one whose last number it follows most closely; None if too many."""
    last: list[int] = []
    owner = np.empty(len(sequence), dtype=np.int64)
    for i, number in enumerate(sequence.tolist()):
        behind = [(number - n, k) for k, n in enumerate(last) if 0 < number - n <= BACKLOG]
        k = min(behind)[1] if behind else len(last)
        if k == len(last):
            if len(last) == PUBLISHERS:
                return None
            last.append(number)
        last[k] = number
        owner[i] = k
    return owner
