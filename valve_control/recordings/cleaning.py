# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Puts the signals of a valve on one time base and leaves out readings that cannot be used."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.recordings.bags.bag import FAR, Series, edges
from valve_control.recordings.clocks import MANY, SMALL_DISORDER, in_order, steps_back
from valve_control.recordings.mapping import Source
from valve_control.recordings.ties import Ties, untied

LEAD = ("spool_position", "valve_voltage", "spool_command")  # whose part is chosen where time was set back
CLOCK_STEPS = 3  # times that a clock may have been set back; more means a file that is not sorted
PUBLISHERS = 8  # that are told apart on one topic
FEW_STAMPS = 3  # from which on a clock is a coarse one
LARGEST = 1e100  # V  of a number that can be squared
BACKLOG = 1000  # numbers by which a publisher may have gone on


class Samples(NamedTuple):
    """One signal of a valve in order of time."""

    topic: str
    time: Integers  # ns, by the clock of the recording
    log_time: Integers  # ns, when it was recorded
    sequence: Integers
    place: Integers  # among all messages of the bag
    value: Floats  # V

    def pick(self, chosen: Any) -> "Samples":
        """Some of the samples, by mask, slice or index."""
        return self._replace(
            time=self.time[chosen],
            log_time=self.log_time[chosen],
            sequence=self.sequence[chosen],
            place=self.place[chosen],
            value=self.value[chosen],
        )


class Cleaned(NamedTuple):
    """Signals by part: spool_command, spool_position, valve_voltage."""

    recorded: dict[str, Samples]  # everything
    timed: dict[str, Samples]  # of one publisher
    usable: dict[str, Samples]  # of one publisher, and finite
    ties: Ties | None  # where the clock is coarser than the messages


def seconds(stamp: Integers, begin: int | Integers = 0) -> Floats:
    """Time [s] from ``begin`` to ``stamp`` [ns]."""
    return (stamp - begin).astype(np.float64) * 1e-9


def clean(
    sources: Mapping[str, Source],
    series: Mapping[str, Series],
    problems: list[str],
    rows: bool = False,
    received: bool = False,
) -> Cleaned:
    """Put the signals of one valve in order; what is left out is named in ``problems``.

    ``series``: their publish_time is of the clock of the recording; ``rows``: they are columns of a table, of
    which a row has one stamp; ``received``: their times are those at which they were recorded.
    """
    raw = {part: _samples(source, series[source.topic], problems) for part, source in sources.items()}
    raw = _one_stretch(raw, problems)
    recorded = {part: _timed(one, problems) for part, one in _in_order(raw, problems).items()}
    ties = untied(recorded, received)
    if ties is not None:
        recorded = {part: one._replace(time=ties.times[part]) for part, one in recorded.items()}
        name = recorded["spool_position"].topic
        by = "in the order of the file" if len(ties.places) else "one after the other within a stamp"
        note = (
            f"stamps on {name} have a resolution of {1e3 * ties.resolution:.4g} ms, which is too coarse for "
            f"latency, jitter and gaps; messages are paired {by}"
        )
        if ties.crossed:
            note = (
                f"times of recording do not tell which voltage answers which reading of {name}; they are "
                "paired by number, and no latency is told"
            )
        if rows and not ties.several:
            note = "command, reading and voltage of a row count as those of one sample; no latency is told"
        problems.append(note)
    timed = {part: _one_publisher(samples, problems) for part, samples in recorded.items()}
    usable = {}
    for part, samples in timed.items():
        if part == "spool_command" and ties is not None and ties.vague:
            problems.append(
                f"the file has topic after topic within a stamp, so the time of a command on {samples.topic} "
                "is not known among the readings: errors are not told"
            )
            samples = samples.pick(slice(0, 0))
        large = np.abs(samples.value) > LARGEST
        if large.any():
            n = int(np.count_nonzero(large & np.isfinite(samples.value)))
            if n:
                problems.append(f"{n} messages of {samples.topic} are beyond {LARGEST:g} V and are left out")
                samples = samples.pick(~(large & np.isfinite(samples.value)))
        keep = np.isfinite(samples.value)
        if not keep.all():
            n = int(np.count_nonzero(~keep))
            problems.append(f"{n} messages of {samples.topic} hold NaN or infinity and are left out")
            samples = samples.pick(keep)
        usable[part] = samples
    return Cleaned(recorded, timed, usable, ties)


def _timed(samples: Samples, problems: list[str]) -> Samples:
    """``samples``, or none of them where they share one or two stamps, between which no time is known."""
    stamps = len(np.unique(samples.time))
    if len(samples.time) < MANY or stamps >= FEW_STAMPS:
        return samples
    problems.append(
        f"the {len(samples.time)} messages of {samples.topic} share {stamps} stamp{'s' * (stamps > 1)}, so "
        "their times are not known; they are left out"
    )
    return samples.pick(slice(0, 0))


def unusable(topic: str, field: str, series: Series) -> list[str]:
    """How many messages of ``topic`` have no ``field``, and how many could not be decoded, in words."""
    absent, said = series.absent.get(field, 0), []
    if absent:
        said.append(f"{absent} messages of {topic} have no {field} and are left out")
    if series.undecodable:
        said.append(
            f"{series.undecodable} messages of {topic} could not be decoded and are left out: {series.error}"
        )
    return said


def _samples(source: Source, series: Series, problems: list[str]) -> Samples:
    problems += unusable(source.topic, source.field, series)
    series = series.having(source.field)
    value = series.values[source.field]
    if source.scale.factor != 1.0:
        value = value * source.scale.factor
    if source.scale.offset != 0.0:
        value = value + source.scale.offset
    return Samples(source.topic, series.publish_time, series.log_time, series.sequence, series.place, value)


def _one_stretch(raw: dict[str, Samples], problems: list[str]) -> dict[str, Samples]:
    """All signals in that stretch of time, hours from others, in which there are most messages."""
    lead = next((part for part in LEAD if part in raw and len(raw[part].time)), None)
    if lead is None or not len(starts := edges(raw[lead].time)):
        return raw
    own = np.searchsorted(starts, raw[lead].time.astype(np.float64), side="right")
    chosen = int(np.argmax(np.bincount(own)))
    kept = {}
    for part, samples in raw.items():
        inside = np.searchsorted(starts - FAR * 5e8, samples.time.astype(np.float64), side="right") == chosen
        kept[part] = samples.pick(inside)
        problems.append(
            f"time of {samples.topic} leaps by hours {len(starts)} time(s); only stretch {chosen + 1} is "
            f"analysed ({np.count_nonzero(inside)} of {len(inside)} messages)"
        )
    return kept


def _in_order(raw: dict[str, Samples], problems: list[str]) -> dict[str, Samples]:
    """Sort by time; if the clock was set back, one part of all signals is kept."""
    steps = {part: steps_back(samples.time, samples.sequence) for part, samples in raw.items()}
    most = max((len(back) for back in steps.values()), default=0)
    lead = next((part for part in LEAD if part in raw and len(steps[part]) == most), "")
    if most and (most <= CLOCK_STEPS or in_order(raw[lead].sequence)):
        bounds = [0, *(steps[lead] + 1).tolist(), len(raw[lead].time)]
        chosen = int(np.argmax(np.diff(bounds)))
        small = bool(np.all(np.diff(raw[lead].time)[steps[lead]] > -round(SMALL_DISORDER * 1e9)))
        kept = {}
        for part, samples in raw.items():
            if len(steps[part]) != most and small:
                begin, end = raw[lead].time[bounds[chosen]], raw[lead].time[bounds[chosen + 1] - 1]
                near = (samples.time >= begin - round(SMALL_DISORDER * 1e9)) & (samples.time <= end)
                kept[part] = samples.pick(near)
                continue
            if len(steps[part]) != most:
                problems.append(
                    f"{samples.topic} is left out: the clock of the recording was set back {most} time(s), "
                    "which does not show on it"
                )
                kept[part] = samples.pick(slice(0, 0))
                continue
            own = [0, *(steps[part] + 1).tolist(), len(samples.time)]
            kept[part] = samples.pick(slice(own[chosen], own[chosen + 1]))
            problems.append(
                f"time goes backwards on {samples.topic} {most} time(s); only part {chosen + 1} "
                f"is analysed ({len(kept[part].time)} of {len(samples.time)} messages)"
            )
        raw = kept
    ordered = {}
    for part, samples in raw.items():
        disorder = int(np.count_nonzero(np.diff(samples.time) < 0))
        if disorder:
            problems.append(f"{disorder} messages of {samples.topic} were out of order and are sorted")
            samples = samples.pick(np.argsort(samples.time, kind="stable"))
        ordered[part] = samples
    return ordered


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
