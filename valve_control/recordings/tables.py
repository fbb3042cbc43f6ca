# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Maps the columns of a table: its times, and what plays the parts of a valve."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from valve_control.control.drivers.scaling import Scale, ScaleError, parse
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.columns import UNITS, Column
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.table import KINDS, TableFile

TIME = "time"
ROW = "row"  # the number of a row from 0, as in time=row*0.001
SCALED = re.compile(r"(?P<source>.+?)\s*(?P<scale>@[^@]+|\*[^*]+)")
USUAL = re.compile(
    r"(?:time|t|zeit|(?P<stamp>(?:time)?stamp))(?:[\s_]*[\[(]\s*|[\s_]+|$)(?P<unit>s|sec|ms|us|µs|ns|)\s*[\])]?",
    re.IGNORECASE,
)
LONGEST = 9e9  # s, as long as nanoseconds can be counted


def maps_of(path: str, maps: Sequence[str], paths: Sequence[str]) -> list[str]:
    """Those of the ``maps`` that are for ``path``, if tables and bags are among the ``paths`` that are read.

    Maps of a table name columns, those of a bag topics, which begin with a slash.
    """
    if len({is_table(other) for other in paths}) < 2:
        return list(maps)
    return [text for text in maps if text.partition("=")[2].strip().startswith("/") != is_table(path)]


def is_table(path: Path | str) -> bool:
    """Whether the name ``path`` is that of a table."""
    return Path(path).suffix.lower() in KINDS


def scaled(text: str) -> tuple[str, Scale]:
    """Source and scale that the map ``text`` names behind its ``=``: ``source[*factor±offset or @word]``.

    Raises BagError.
    """
    right = text.partition("=")[2].strip()
    found = SCALED.fullmatch(right)
    if found is None:
        return right, Scale(1.0)
    try:
        return found["source"].strip(), parse(found["scale"].removeprefix("@"))
    except ScaleError as error:
        raise BagError(f"--map {text}: {error}") from None


def column_of(table: TableFile, text: str) -> tuple[str, Scale]:
    """Column and scale that the map ``text`` names, the column by its exact name or its number from 1.

    Without a scale that of the column's unit.
    """
    right = text.partition("=")[2].strip()
    name, scale = (right, Scale(1.0)) if table.named(right) else scaled(text)
    if scale == Scale(1.0) and (name != ROW or table.named(ROW)):
        scale = unit_of(table.columns[table.column(name)])
    return name, scale


def unit_of(column: Column) -> Scale:
    """Factor of the column's unit to s or V, 1 without one that is known."""
    return Scale(UNITS.get(column.unit.lower(), 1.0))


def unit_notes(table: TableFile, topics: Sequence[str]) -> list[str]:
    """What the units of the columns ``topics`` are, where that is not said by them."""
    used = [c for topic, c in zip(table.topics, table.columns, strict=True) if topic.name in topics]
    unknown = [c for c in used if c.unit and c.unit.lower() not in UNITS]
    notes = [f"the unit {c.unit} of {c.bare_name} is not known: it counts as V" for c in unknown]
    if used and not any(c.unit for c in used):
        notes.append("no column has a unit: all count as V")
    return notes


def take_times(bag: Bag, maps: Sequence[str]) -> list[str]:
    """The ``maps`` of parts; those of the time tell when the rows of a table were taken.

    Without such a map a column with a usual name is taken. Raises BagError.
    """
    timed = [text for text in dict.fromkeys(maps) if text.partition("=")[0].strip() == TIME]
    rest = [text for text in maps if text not in timed]
    table = bag.table
    if table is None:
        if timed:
            raise BagError(f"--map {timed[0]}: {bag.path} has times of its own; only a table's are mapped")
        return rest
    if len(timed) > 1:
        raise BagError(f"--map {timed[1]}: the time is mapped already, by --map {timed[0]}")
    name, scale = column_of(table, timed[0]) if timed else _usual(table)
    if name == ROW and not table.named(ROW):
        # Rows of the first column that is mapped, or of most columns.
        counts = Counter(len(column.values) for column in table.columns)
        mapped = [len(table.columns[table.column(column_of(table, text)[0])].values) for text in rest[:1]]
        count = next(iter(mapped), max(counts, key=lambda rows: (counts[rows], rows)))
        values = np.arange(count, dtype=np.float64)
        clock = f"{ROW}{scale}"
    else:
        column = table.columns[table.column(name)]
        if column.flaw:
            raise BagError(f"{bag.path}: {column.flaw}")
        values = column.values
        clock = f"column {name}{scale if scale != Scale(1.0) else ''}"
    if not timed:
        bag.problems.append(f"the time is {clock}, in seconds; --map time=COLUMN*FACTOR takes another")
    _check(bag.path, values, scale, clock)
    bag.use_times(np.round((values * scale.factor + scale.offset) * 1e9).astype(np.int64), clock)
    return rest


def _usual(table: TableFile) -> tuple[str, Scale]:
    """The only column whose name is that of a time. Raises BagError if there is none, or several."""
    times = [
        (column.name, named, unit_of(column) if column.unit else Scale(UNITS[named["unit"].lower() or "s"]))
        for column in table.columns
        if (named := USUAL.fullmatch(column.name)) and not column.flaw
    ]
    found = [
        (name, unit)
        for name, named, unit in times
        if not named["stamp"] or all(other["stamp"] for _, other, _ in times)
    ]
    if len(found) == 1:
        return found[0]
    several = f"{', '.join(name for name, _ in found)} may be times; " if found else ""
    raise BagError(
        f"{table.path}: {several}say when its rows were taken: --map time=COLUMN*FACTOR in seconds, or "
        f"--map time=row*PERIOD; its columns are {table.listed}"
    )


def empty_notes(table: TableFile, topics: Sequence[str]) -> list[str]:
    """Where cells of the columns ``topics`` are empty, in words."""
    return [
        f"{topic.name.removeprefix('/')} is empty in {np.count_nonzero(~column.filled)} of "
        f"{len(column.filled)} rows"
        for topic, column in zip(table.topics, table.columns, strict=True)
        if topic.name in topics and not column.filled.all()
    ]


def _check(path: Path, values: npt.NDArray[np.float64], scale: Scale, clock: str) -> None:
    """Raise BagError unless ``values`` times ``scale`` are times of rows one after the other."""
    if len(values) < 2:
        raise BagError(f"{path} has {len(values)} row(s); a recording needs more")
    unknown = np.flatnonzero(~np.isfinite(values))
    if len(unknown):
        raise BagError(f"{path} has no time in row {unknown[0] + 1} ({clock}); each row needs one")
    times = values * scale.factor + scale.offset
    back = np.flatnonzero(np.diff(times) < 0.0)
    if len(back):
        at = int(back[0])
        raise BagError(
            f"{path}: the time runs backwards from row {at + 1} to row {at + 2}, from {times[at]:.10g} to "
            f"{times[at + 1]:.10g} s ({clock}); sort the rows, or cut the file there"
        )
    if times[-1] == times[0]:
        raise BagError(f"{path}: all rows have the same time, {times[0]:.10g} s ({clock})")
    if np.max(np.abs(times)) > LONGEST:
        raise BagError(
            f"{path}: the time reaches {times[int(np.argmax(np.abs(times)))]:.3g} s ({clock}); give its "
            "factor to seconds, as in --map time=stamp_ns*1e-9"
        )
