# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Puts the signals of a valve on one time base and leaves out readings that cannot be used."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.recordings.bags.bag import Series
from valve_control.recordings.bags.table import TableFile
from valve_control.recordings.clocks import MANY, SMALL_DISORDER, leaps
from valve_control.recordings.mapping import Source
from valve_control.recordings.pairing import Pairs, Samples, by_row, paired

LEAD = ("spool_position", "valve_voltage", "spool_command")  # whose part is chosen where time was set back
FEW_STAMPS = 3  # from which on a clock is a coarse one
FALLS = 0.2  # of the numbers that may go back, as of messages out of order
LARGEST = 1e100  # V  of a number that can be squared


class Cleaned(NamedTuple):
    """Signals by part: spool_command, spool_position, valve_voltage."""

    recorded: dict[str, Samples]  # everything
    usable: dict[str, Samples]  # what is finite
    pairs: Pairs | None  # where stamps do not tell which messages belong together


def seconds(stamp: Integers, begin: int | Integers = 0) -> Floats:
    """Time [s] from ``begin`` to ``stamp`` [ns]."""
    return (stamp - begin).astype(np.float64) * 1e-9


def clean(
    sources: Mapping[str, Source],
    series: Mapping[str, Series],
    problems: list[str],
    table: TableFile | None = None,
    received: bool = False,
) -> Cleaned:
    """Put the signals of one valve in order; what is left out is named in ``problems``.

    ``series``: their publish_time is of the clock of the recording; ``table``: they are columns of it;
    ``received``: their times are those at which they were recorded.
    """
    raw = {part: _samples(source, series[source.topic], problems) for part, source in sources.items()}
    recorded = {part: _checked(one, problems) for part, one in _in_order(raw, problems).items()}
    pairs = paired(recorded, received) if table is None else by_row(recorded, table)
    if pairs is not None:
        recorded = {part: one._replace(time=pairs.times[part]) for part, one in recorded.items()}
        problems.append(_note(pairs, table is not None))
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
    return Cleaned(recorded, usable, pairs)


def _note(pairs: Pairs, rows: bool) -> str:
    """How the signals are paired with the readings."""
    name = pairs.lead
    if pairs.crossed and rows:
        return "command, reading and voltage of a row count as those of one sample; no latency is told"
    if pairs.crossed:
        return (
            f"times of recording do not tell which voltage answers which reading of {name}; they are paired "
            "by number, and no latency is told"
        )
    return (
        f"stamps on {name} have a resolution of {1e3 * pairs.resolution:.4g} ms, which is too coarse for "
        "latency, jitter and gaps; messages are paired by their order"
    )


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
