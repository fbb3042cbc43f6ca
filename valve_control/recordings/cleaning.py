# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Puts the signals of a valve on one time base and leaves out readings that cannot be used.

Where stamps do not tell what belongs together, readings, voltages and commands are paired by their order: a
simulated clock often goes on by 10 ms, so ten readings and their ten voltages have one stamp. Their order in
the file, and where that has topic after topic their order within the stamp, tells the pairs.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from valve_control.arrays import Floats, Integers
from valve_control.control.analysis.timing import LATE, true_period
from valve_control.recordings.bags.bag import Series
from valve_control.recordings.bags.table import TableFile
from valve_control.recordings.clocks import MANY, SMALL_DISORDER, in_order, leaps, shared
from valve_control.recordings.mapping import Source

LEAD = ("spool_position", "valve_voltage", "spool_command")  # whose part is chosen where time was set back
FEW_STAMPS = 3  # from which on a clock is a coarse one
FALLS = 0.2  # of the numbers that may go back, as of messages out of order
LARGEST = 1e100  # V  of a number that can be squared
BOTH = 0.2  # of the voltages that have the stamp of a reading where the clock is coarse
INTERLEAVED = 0.8  # of the messages of two topics that alternate where their order in the file counts
SAME_RATE = 0.1  # by which numbers may go on faster or slower than those of the readings, one for each
DISORDER = 0.01  # of the messages that may be out of order in the file where it counts
CROSSED = 0.02  # of the voltages that may be recorded before their reading, or behind the next
WINDOW = 101  # messages whose usual distance to the readings counts for the one in their middle
PARTS_OF_ROW = ("spool_command", "spool_position", "valve_voltage")  # of a table, in order of time
LATER = 0.6  # of a period from a reading to the command that was there after it


class Samples(NamedTuple):
    """One signal of a valve in order of time."""

    topic: str
    time: Integers  # ns, by the clock of the recording
    log_time: Integers  # ns, when it was recorded
    sequence: Integers  # numbers of the publisher
    place: Integers  # among all messages of the bag
    value: Floats  # V

    def pick(self, chosen: Any) -> "Samples":
        """Some of the samples, by mask, slice or index."""
        return Samples(self.topic, *(column[chosen] for column in self[1:]))


class Pairs(NamedTuple):
    """Times of messages whose stamps do not tell what belongs together."""

    lead: str  # topic whose messages the others are paired with, as a rule the readings
    resolution: float  # s, usual step from one stamp to the next
    times: dict[str, Integers]  # ns, by part
    places: Integers  # of the readings, if the order in the file counts
    vague: list[str]  # parts of which nothing tells between which readings they came
    crossed: bool  # whether stamps tell all but the order of readings and answers

    def of(self, time: Integers, place: Integers) -> Integers:
        """Times [ns] of messages with the stamps ``time`` by their ``place`` between the readings."""
        if not len(self.places):
            return time
        known = self.times["spool_position"]
        moved = known[0] + np.round(np.interp(place, self.places, known - known[0])).astype(np.int64)
        inside = (place >= self.places[0]) & (place <= self.places[-1])
        near = inside & (np.abs(moved - time) <= 2e9 * self.resolution)  # not over a gap
        return np.asarray(np.maximum.accumulate(np.where(near, moved, time)), dtype=np.int64)


def paired(signals: Mapping[str, Samples], received: bool = False) -> Pairs | None:
    """Times of the signals of a valve of which many share their stamps; None if they do not.

    Likewise of times of recording (``received``) that put many voltages before the readings that they answer.
    Voltages, and commands that are as many as the readings, keep their distance to these in numbers.
    """
    readings, voltages = signals.get("spool_position"), signals.get("valve_voltage")
    if readings is None or len(readings.time) < 2:
        return None
    several, answered = shared(readings.time), readings.time[:0] if voltages is None else voltages.time
    together = int(np.count_nonzero(np.isin(answered, readings.time)))
    crossed = not several and together <= BOTH * min(len(readings.time), len(answered))
    if crossed and not (received and voltages is not None and _crossed(readings, voltages)):
        return None
    answers = signals.get("valve_voltage", signals.get("spool_command"))
    ordered = several and answers is not None and _interleaved(readings.place, answers.place)
    times = {part: spread(one.time, one.sequence) for part, one in signals.items()}
    places = np.maximum.accumulate(readings.place) if ordered else readings.place[:0]
    pairs = Pairs(readings.topic, _resolution(readings.time), times, places, [], crossed)
    numbers, lead = _padded(_numbers(readings.sequence), 1), times["spool_position"]
    known = _padded(lead, round(float(np.median(np.diff(lead)))))
    for part, one in signals.items():
        if part == "spool_position" or len(one.time) < MANY:
            continue
        keys = (places, one.place) if ordered else (lead, times[part])
        answer = part == "valve_voltage"
        number, ahead = _numbers(one.sequence), _ahead(numbers, one, keys, answer)
        if ahead is not None:
            reading = number + median_filter(ahead, WINDOW, mode="mirror")
            share = np.interp(reading + (0.0 if answer else LATER), numbers, known - known[0])
            moved = known[0] + np.round(share).astype(np.int64) + answer
            near = np.abs(moved - times[part]) <= 2e9 * pairs.resolution
            times[part] = np.maximum.accumulate(np.where(near, moved, times[part]))
        elif ordered:
            times[part] = pairs.of(times[part], one.place)
        elif several:
            pairs.vague.append(part)
    return pairs


def _padded(column: Integers, step: int) -> Integers:
    """``column`` with one entry more, a ``step`` away, at each end."""
    return np.concatenate([[column[0] - step], column, [column[-1] + step]])


def _ahead(numbers: Integers, one: Samples, keys: tuple[Integers, Integers], answer: bool) -> Integers | None:
    """By how much the number of the reading beside each message is larger than its own number.

    ``numbers``: of the readings, padded; ``keys``: of readings and messages, which tell what is beside each
    other. None where messages and readings do not come at one rate.
    """
    # The reading after which a message comes; a command with the key of a reading is there before it.
    reading = numbers[np.searchsorted(*keys, side="right" if answer else "left")]
    number = _numbers(one.sequence)
    among = (reading >= numbers[1]) & (reading < numbers[-2])
    own, of_readings = (np.ptp(some[among]) if among.any() else 0 for some in (number, reading))
    same_rate = of_readings > 0 and abs(own / of_readings - 1.0) < SAME_RATE
    return np.asarray(reading - number) if same_rate else None


def _interleaved(place: Integers, other: Integers) -> bool:
    """Whether the messages of two topics, by their places in the file, alternate as they were sent."""
    if len(other) == 0 or any(np.mean(np.diff(some) <= 0) > DISORDER for some in (place, other)):
        return False
    alternating = len(np.unique(np.searchsorted(np.maximum.accumulate(place), other)))
    return alternating > INTERLEAVED * min(len(place), len(other))


def _crossed(readings: Samples, voltages: Samples) -> bool:
    """Whether many voltages come beside another reading than their number says, by a steady difference."""
    numbers, keys = _padded(_numbers(readings.sequence), 1), (readings.time, voltages.time)
    beside = _ahead(numbers, voltages, keys, True)
    if beside is None or min(len(readings.time), len(beside)) < WINDOW:
        return False
    usual = median_filter(beside, WINDOW, mode="mirror")
    return float(np.mean(beside != usual)) > CROSSED and float(np.mean(np.diff(usual) != 0)) < CROSSED


def by_row(signals: Mapping[str, Samples], table: TableFile) -> Pairs:
    """Times of the columns of a table: in its row a command is before the reading and a voltage behind it."""
    rows = {part: table.row_times(one.topic) for part, one in signals.items()}
    times = {
        part: spread(time, np.zeros_like(time))[np.searchsorted(number, signals[part].place)]
        + PARTS_OF_ROW.index(part) - 1
        for part, (number, time) in rows.items()
    }  # fmt: skip
    lead = signals.get("spool_position", next(iter(signals.values())))
    apart = not any(shared(time) for _, time in rows.values())
    return Pairs(lead.topic, _resolution(lead.time), times, np.empty(0, dtype=np.int64), [], apart)


def _resolution(time: Integers) -> float:
    """Usual step [s] from one stamp [ns] to the next."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) * 1e-9 if len(steps) else 0.0


def _numbers(sequence: Integers) -> Integers:
    """Numbers of the publisher, or from 0 where it has none that are in order."""
    return sequence if in_order(sequence) else np.arange(len(sequence), dtype=np.int64)


def spread(time: Integers, sequence: Integers) -> Integers:
    """Stamps [ns], in order, spread by number from the first message of a stamp to that of the next."""
    first = np.flatnonzero(np.diff(time, prepend=time[:1] - 1) > 0)
    if len(first) < 3 or len(first) == len(time):
        return time
    number, anchors = _numbers(sequence), first[1:]  # of the first stamp there may be the last messages only
    slopes = np.diff(time[anchors]) / np.diff(number[anchors])
    measured = 1e9 * true_period(time, sequence)
    period = measured if measured > 0.0 else float(np.median(slopes))
    # After a pause messages come as soon as before it.
    slopes = np.append(np.minimum(slopes, LATE * period), period)
    own = np.searchsorted(anchors, np.arange(len(time)), side="right") - 1
    before = min(period, (time[anchors[0]] - time[0]) / (number[anchors[0]] - number[0]))
    at = anchors[np.maximum(own, 0)]
    moved = np.round((number - number[at]) * np.where(own < 0, before, slopes[own])).astype(np.int64)
    return np.asarray(time[at] + moved, dtype=np.int64)


def seconds(stamp: Integers, begin: int | Integers = 0) -> Floats:
    """Time [s] from ``begin`` to ``stamp`` [ns]."""
    return (stamp - begin).astype(np.float64) * 1e-9


def clean(
    sources: Mapping[str, Source],
    series: Mapping[str, Series],
    problems: list[str],
    table: TableFile | None = None,
    received: bool = False,
) -> tuple[dict[str, Samples], dict[str, Samples], Pairs | None]:
    """Put the signals of one valve in order; what is left out is named in ``problems``.

    Returns all samples by part, the finite ones, and pairs where stamps do not tell what belongs together.
    ``series``: their publish_time is of the clock of the recording; ``table``: they are columns of it;
    ``received``: their times are those at which they were recorded.
    """
    raw = {part: _samples(source, series[source.topic], problems) for part, source in sources.items()}
    recorded = {part: _checked(one, problems) for part, one in _in_order(raw, problems).items()}
    pairs = paired(recorded, received) if table is None else by_row(recorded, table)
    if pairs is not None:
        recorded = {part: one._replace(time=pairs.times[part]) for part, one in recorded.items()}
        if pairs.crossed:
            problems.append(
                "command, reading and voltage of a row count as those of one sample; no latency is told"
                if table is not None
                else "times of recording do not tell which voltage answers which reading of "
                f"{pairs.lead}; they are paired by number, and no latency is told"
            )
        else:
            problems.append(
                f"stamps on {pairs.lead} have a resolution of {1e3 * pairs.resolution:.4g} ms, which is too "
                "coarse for latency, jitter and gaps; messages are paired by their order"
            )
        for part in pairs.vague:
            problems.append(
                f"the file has topic after topic within a stamp, so the times on {recorded[part].topic} are "
                "not known among the readings: it is left out"
            )
    usable = {}
    for part, samples in recorded.items():
        keep = np.abs(samples.value) <= LARGEST
        if not keep.all():
            problems.append(
                f"{np.count_nonzero(~keep)} messages of {samples.topic} hold NaN, infinity or more than "
                f"{LARGEST:g} V and are left out"
            )
        vague = pairs is not None and part in pairs.vague
        usable[part] = samples.pick(slice(0, 0)) if vague else samples if keep.all() else samples.pick(keep)
    return recorded, usable, pairs


def unusable(topic: str, field: str, series: Series) -> list[str]:
    """How many messages of ``topic`` have no ``field``, and how many could not be decoded, in words."""
    absent, notes = series.absent.get(field, 0), []
    if absent:
        notes.append(f"{absent} messages of {topic} have no {field} and are left out")
    if series.undecodable:
        notes.append(
            f"{series.undecodable} messages of {topic} could not be decoded and are left out: {series.error}"
        )
    return notes


def _samples(source: Source, series: Series, problems: list[str]) -> Samples:
    problems += unusable(source.topic, source.field, series)
    series = series.having(source.field)
    value = series.values[source.field]
    if source.scale.factor != 1.0:
        value = value * source.scale.factor
    if source.scale.offset != 0.0:
        value = value + source.scale.offset
    return Samples(source.topic, series.publish_time, series.log_time, series.sequence, series.place, value)


def _in_order(raw: dict[str, Samples], problems: list[str]) -> dict[str, Samples]:
    """Sort by time; if the clock was set back, the longest part of the readings, and the others during it."""
    lead = next((part for part in LEAD if part in raw and len(raw[part].time)), "")
    back = leaps(raw[lead].time, raw[lead].sequence) if lead else np.empty(0, dtype=np.int64)
    if len(back):
        bounds = [0, *(back + 1).tolist(), len(raw[lead].time)]
        longest = int(np.argmax(np.diff(bounds)))
        part = raw[lead].pick(slice(bounds[longest], bounds[longest + 1]))
        begin, end = part.time[0] - round(SMALL_DISORDER * 1e9), part.time[-1] + round(SMALL_DISORDER * 1e9)
        first, last = (int(part.place[0]) if longest else -1), int(part.place[-1])
        last = last if longest < len(back) else np.iinfo(np.int64).max
        inside = {
            name: (one.time >= begin) & (one.time <= end) & (one.place >= first) & (one.place <= last)
            for name, one in raw.items()
        }
        problems += [
            f"time leaps on {raw[lead].topic} {len(back)} time(s); only part {longest + 1} of "
            f"{one.topic} is analysed ({np.count_nonzero(inside[name])} of {len(one.time)} messages)"
            for name, one in raw.items()
        ]
        raw = {name: one.pick(inside[name]) for name, one in raw.items()}
    ordered = {}
    for name, samples in raw.items():
        disorder = int(np.count_nonzero(np.diff(samples.time) < 0))
        if disorder:
            problems.append(f"{disorder} messages of {samples.topic} were out of order and are sorted")
            samples = samples.pick(np.argsort(samples.time, kind="stable"))
        ordered[name] = samples
    return ordered


def _checked(samples: Samples, problems: list[str]) -> Samples:
    """``samples``; none where they share one or two stamps; without numbers that are not one publisher's."""
    stamps = 1 + int(np.count_nonzero(np.diff(samples.time)))
    if len(samples.time) >= MANY and stamps < FEW_STAMPS:
        problems.append(
            f"the {len(samples.time)} messages of {samples.topic} share {stamps} stamp{'s' * (stamps > 1)}, "
            "so their times are not known; they are left out"
        )
        return samples.pick(slice(0, 0))
    falls = int(np.count_nonzero(np.diff(samples.sequence) <= 0)) if np.any(samples.sequence) else 0
    if falls > max(MANY, FALLS * len(samples.sequence)):
        problems.append(
            f"the numbers of {samples.topic} go back {falls} times, as those of several publishers: they are "
            "not used, and all messages count"
        )
        return samples._replace(sequence=np.zeros_like(samples.sequence))
    return samples
