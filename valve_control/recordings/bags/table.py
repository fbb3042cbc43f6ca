# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads logs as bags: each column is a topic of std_msgs/Float64, with times by a column of times or rows."""

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.control.drivers.scaling import Scale, ScaleError, parse
from valve_control.recordings.bags import logs
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.logs import TIME, UNITS, Column
from valve_control.recordings.bags.messages import Block, Topic, absolute

FLOAT = "std_msgs/msg/Float64"
PART = "time"  # of a map
ROW = "row"  # the number of a row from 0, as in time=row*0.001
SCALED = re.compile(r"(?P<source>.+?)\s*(?P<scale>@[^@]+|\*[^*]+)")
LONGEST = 9e9  # s, as long as nanoseconds can be counted
GAP = 5.0  # usual steps of time from which on rows are missing
SLOW, LARGE = 0.1, 50.0  # s between rows, V of a tenth of them, from which on it may be ms, mV or %
ONE = Scale(1.0)


def scaled(text: str) -> tuple[str, Scale]:
    """Source and scale that the map ``text`` names behind its ``=``: ``source[*factor±offset or @word]``.

    Raises BagError.
    """
    right = text.partition("=")[2].strip()
    found = SCALED.fullmatch(right)
    if found is None:
        return right, ONE
    try:
        return found["source"].strip(), parse(found["scale"].removeprefix("@"))
    except ScaleError as error:
        raise BagError(f"--map {text}: {error}") from None


def unit_of(column: Column) -> Scale:
    """Factor of the column's unit to s or V, 1 without one that is known."""
    return Scale(UNITS.get(column.unit.lower(), 1.0))


class TableFile:
    """One table, whose rows have no times until ``take_times``.

    Raises BagError if it is none, OSError if it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self.damaged: set[int] = set()
        self.size = path.stat().st_size
        self.columns = logs.read(path, self.problems)
        self.topics = [
            Topic(absolute(name), FLOAT, flaw=column.flaw)
            for name, column in zip(self._topic_names(), self.columns, strict=True)
        ]
        none = np.empty(0, dtype=np.int64)
        self.times = [(none, none)] * len(self.columns)  # rows that have a time, and these times [ns]
        self.clock = ""  # what these times are of

    def _topic_names(self) -> list[str]:
        """Names of the columns, for those that have none of their own their numbers."""
        names = [column.bare_name for column in self.columns]
        found = [
            name if name and names.count(name) == 1 else column.name or str(number)
            for number, (name, column) in enumerate(zip(names, self.columns, strict=True), start=1)
        ]
        counts = Counter(found)
        found = [name if counts[name] == 1 else str(number) for number, name in enumerate(found, start=1)]
        if len(set(map(absolute, found))) < len(found):  # the name of one is the number of another
            return [str(number) for number in range(1, 1 + len(found))]
        return found

    @property
    def listed(self) -> str:
        """Names of the columns, in words."""
        return ", ".join(topic.name.removeprefix("/") for topic in self.topics)

    def column(self, name: str) -> int:
        """Index of the column with this name, or else this number from 1. Raises BagError."""
        found = [i for i, column in enumerate(self.columns) if name == column.name]
        found = found or [i for i, column in enumerate(self.columns) if name == column.bare_name]
        if len(found) > 1:
            numbers = " and ".join(str(i + 1) for i in found)
            raise BagError(f"{self.path} has {len(found)} columns {name}; take one by its number: {numbers}")
        if not found and name.isdigit() and 1 <= int(name) <= len(self.columns):
            found = [int(name) - 1]
        if not found:
            raise BagError(f"{self.path} has no column {name}; it has {self.listed}")
        return found[0]

    def source(self, text: str) -> tuple[int | None, Scale]:
        """Column and scale that the map ``text`` names, the column by its exact name or its number from 1.

        None for the number of the row; without a scale that of the column's unit. Raises BagError.
        """
        right = text.partition("=")[2].strip()
        known = {name for column in self.columns for name in (column.name, column.bare_name)}
        name, scale = (right, ONE) if right in known else scaled(text)
        if name == ROW and ROW not in known:
            return None, scale
        at = self.column(name)
        return at, unit_of(self.columns[at]) if scale == ONE else scale

    def close(self) -> None:
        """Close the file, which has been read as a whole."""

    def blocks(self) -> Iterator[Block]:
        """No messages: columns are taken as they are."""
        return iter(())

    def take_times(self, maps: Sequence[str], notes: list[str]) -> list[str]:
        """The ``maps`` of parts; those of the time tell when the rows were taken.

        Without such a map the column with a usual name is taken, or the only one with date and time. Several
        of the same name tell the times of those that stand beside or behind them. Raises BagError.
        """
        timed = [text for text in dict.fromkeys(maps) if text.partition("=")[0].strip() == PART]
        rest = [text for text in maps if text not in timed]
        if len(timed) > 1:
            raise BagError(f"--map {timed[1]}: the time is mapped already, by --map {timed[0]}")
        if not timed:
            self._take_own(notes)
            return rest
        at, scale = self.source(timed[0])
        if at is None:
            # Rows of the first column that is mapped, or of most columns.
            counts = Counter(len(column.values) for column in self.columns)
            mapped = [i for text in rest[:1] for i, _ in (self.source(text),) if i is not None]
            most = max(counts, key=lambda rows: (counts[rows], rows))
            count = len(self.columns[mapped[0]].values) if mapped else most
            values, self.clock = np.arange(count, dtype=np.float64), f"{ROW}{scale}"
        else:
            if flaw := self.columns[at].flaw:
                raise BagError(f"{self.path}: {flaw}")
            values, self.clock = self.columns[at].values, self._clock(at, scale)
        self._use(values, scale, range(len(self.columns)))
        return rest

    def _clock(self, at: int, scale: Scale) -> str:
        column = self.columns[at]
        since = f" since {column.since}" if column.since else ""
        return f"column {column.name or at + 1}{scale if scale != ONE else ''}{since}"

    def _take_own(self, notes: list[str]) -> None:
        """Take the times of the columns that are times by their names. Raises BagError."""
        ends = [column.name.rpartition(".")[2] for column in self.columns]
        named = {i: found for i, end in enumerate(ends) if (found := TIME.fullmatch(end))}
        named = {i: found for i, found in named.items() if not self.columns[i].flaw}
        plain = [i for i, found in named.items() if not found["stamp"]]
        dated = [i for i, column in enumerate(self.columns) if column.since and not column.flaw]
        times = plain or list(named) or dated
        if not times or len({ends[i].casefold() for i in times}) > 1:
            several = f"{', '.join(self.columns[i].name for i in times)} may be times; " if times else ""
            raise BagError(
                f"{self.path}: {several}say when its rows were taken: --map time=COLUMN*FACTOR in seconds, "
                f"or --map time=row*PERIOD; its columns are {self.listed}"
            )
        owner = [
            max(times, key=lambda t: (self._shared(t, i), t <= i, -abs(t - i)))
            for i in range(len(self.columns))
        ]
        for at in times:
            own = [i for i, time in enumerate(owner) if time == at]
            try:
                self._use_column(at, named[at]["unit"].lower() if at in named else "", own)
            except BagError as error:
                if len(times) == 1:
                    raise
                for i in own:
                    self._refuse(i, str(error))
        if len(times) > 1:
            self.clock = f"{len(times)} columns {ends[times[0]]}, each for the signals behind it"
        notes.append(f"the time is {self.clock}, in seconds; --map time=COLUMN*FACTOR takes another")

    def _use_column(self, at: int, unit: str, own: Sequence[int]) -> None:
        """Take the column ``at``, with this unit in its name, as the time of the columns ``own``."""
        column = self.columns[at]
        unit = column.unit.lower() or unit
        scale = Scale(UNITS.get(unit, 1.0))
        self.clock = self._clock(at, scale)
        if unit not in ("", *UNITS):
            raise BagError(f"{self.path}: the unit {unit} of {self.clock} is not known; map the time")
        if not unit and not column.since and len(column.values) > 2 and np.all(np.diff(column.values) == 1.0):
            counted = ", ".join(f"{value:g}" for value in column.values[:3])
            raise BagError(
                f"{self.path}: {self.clock} counts {counted} without a unit; give the time of a step: "
                f"--map time={column.name}*0.001, or *1 for seconds"
            )
        self._use(column.values, scale, own)

    def _shared(self, one: int, other: int) -> int:
        """Length of the path that the names of two columns share, as of two fields of a structure."""
        paths = (self.columns[one].name.rpartition(".")[0], self.columns[other].name.rpartition(".")[0])
        shared = os.path.commonprefix([path.split(".") for path in paths])
        return len(shared)

    def _use(self, values: Floats, scale: Scale, own: Sequence[int]) -> None:
        """Take ``values`` times ``scale`` [s] as the times of the columns ``own``.

        Columns with another number of rows cannot be read from then on. Raises BagError.
        """
        count = len(values)
        for i in own:
            column, rows = self.columns[i], len(self.columns[i].values)
            if rows != count:
                name = column.name or i + 1
                self._refuse(i, f"column {name} has {rows} rows and the time {count}; they must agree")
        filled = [~np.isnan(self.columns[i].values) for i in own if not self.columns[i].flaw]
        timed = np.flatnonzero(np.logical_or.reduce(filled)) if filled else np.arange(count)
        self._check(timed, values[timed], scale)
        times = np.round((values[timed] * scale.factor + scale.offset) * 1e9).astype(np.int64)
        for i in own:
            self.times[i] = timed, times

    def _refuse(self, at: int, flaw: str) -> None:
        """The column ``at`` cannot be read from now on, for this reason."""
        if not self.columns[at].flaw:
            self.columns[at] = self.columns[at]._replace(flaw=flaw)
            self.topics[at] = self.topics[at]._replace(flaw=flaw)

    def _check(self, rows: Integers, values: Floats, scale: Scale) -> None:
        """Raise BagError unless ``values`` times ``scale`` are times of ``rows`` one after the other."""
        path, clock = self.path, self.clock
        if len(values) < 2:
            raise BagError(f"{path} has {len(values)} row(s); a recording needs more")
        unknown = np.flatnonzero(~np.isfinite(values))
        if len(unknown):
            raise BagError(f"{path} has no time in row {rows[unknown[0]] + 1} ({clock}); each row needs one")
        times = values * scale.factor + scale.offset
        steps = np.diff(times)
        back = np.flatnonzero(steps < 0.0)
        if len(back):
            at = int(back[0])
            raise BagError(
                f"{path}: the time runs backwards from row {rows[at] + 1} to row {rows[at + 1] + 1}, from "
                f"{times[at]:.10g} to {times[at + 1]:.10g} s ({clock}); sort the rows, or cut the file there"
            )
        if times[-1] == times[0]:
            raise BagError(f"{path}: all rows have the same time, {times[0]:.10g} s ({clock})")
        if np.max(np.abs(times)) > LONGEST:
            raise BagError(
                f"{path}: the time reaches {times[int(np.argmax(np.abs(times)))]:.3g} s ({clock}); give its "
                "factor to seconds, as in --map time=stamp_ns*1e-9"
            )

    def row_times(self, topic: str) -> tuple[Integers, Integers]:
        """Rows that have a time for the column of this topic, and their times [ns]."""
        return self.times[next(i for i, known in enumerate(self.topics) if known.name == topic)]

    def notes_on(self, scales: Mapping[str, Scale]) -> list[str]:
        """Where cells of these topics are empty, and which units count as V; ``scales``: of the maps."""
        found = [i for i, topic in enumerate(self.topics) if topic.name in scales]
        used, notes = [self.columns[i] for i in found], []
        for i, column in zip(found, used, strict=True):
            rows = self.times[i][0]
            steps = np.diff(self.times[i][1]) * 1e-9
            usual = np.median(steps[steps > 0.0]) if steps.any() else np.inf
            if SLOW <= usual < np.inf:
                notes.append(f"the rows are {usual:.4g} s apart; if this is ms: --map time=COLUMN*0.001")
            name, size = self.topics[i].name.removeprefix("/"), np.abs(np.nan_to_num(column.values[rows]))
            if len(size) and scales[self.topics[i].name] == ONE and (top := np.quantile(size, 0.9)) > LARGE:
                notes.append(f"{name} goes to {top:.4g} V; map {name}*0.001 if it is in mV, {name}@% if in %")
            for gap in (gaps := np.flatnonzero(steps > GAP * usual))[:1]:
                notes.append(
                    f"the time leaps by more than {GAP:g} usual steps in {len(gaps)} place(s), the first "
                    f"from row {rows[gap] + 1} to row {rows[gap + 1] + 1}, by {steps[gap]:.4g} s: rows are "
                    "missing"
                )
            if empty := np.count_nonzero(np.isnan(column.values[rows])):
                notes.append(f"{name} is empty in {empty} of {len(rows)} rows")
        bare = [self.columns[i] for i in found if scales[self.topics[i].name] == ONE]
        unknown = [c for c in bare if c.unit and c.unit.lower() not in UNITS]
        notes += [f"{c.bare_name} in {c.unit} counts as V without @%, @4..20mA or *FACTOR" for c in unknown]
        if bare and not any(c.unit for c in used):
            notes.append("no column has a unit: all count as V")
        return list(dict.fromkeys(notes))
