# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads logs as columns of numbers: text (CSV, TwinCAT Scope, LabVIEW), MATLAB's .mat and ASAM's MDF.

MATLAB's objects and version 7.3 are read with mat-io, MDF with asammdf: both are the extra ``logs``.
"""

import csv
import datetime
import functools
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.recordings.bags.errors import BagError

SEPARATORS = (";", "\t", ",", " ")
HEAD = 50  # lines among which the first row of numbers is
ROWS = 50_000  # that are taken at once
COMMENTS = ("#", "%")
MISSING = {"", "na", "n/a", "null"}
THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*")
UNITS = {
    **{"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    **{"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "uv": 1e-6, "µv": 1e-6, "kv": 1e3},
    **{"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9},
}  # in lower case, in s or V
NAMED_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\W\d][^\])]*?)\s*[\])]")
TIME = re.compile(
    r"(?:time|t|zeit|x_value|(?P<stamp>(?:time)?stamp))"
    r"(?:[\s_]*[\[(]\s*|[\s_]+|$)(?P<unit>s|sec|ms|us|µs|ns|)\s*[\])]?",
    re.IGNORECASE,
)  # a usual name of a time
STAMP = re.compile(
    r"(?:(\d{4})([-/.])(\d\d?)\2(\d\d?)|(\d\d?)\.(\d\d?)\.(\d{4}))?"
    r"(?:(?:^|[T ,;])\s*(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?)?(?:Z|[+-]\d\d:?\d\d)?"
)  # date, time of day, or both; zones are not regarded
DAY = 86_400 * 10**9  # ns
LONGEST = 40  # characters of a cell that are shown


class Column(NamedTuple):
    """A column of a table."""

    name: str  # "" without header; of a MATLAB file the path of a vector
    values: Floats
    filled: npt.NDArray[np.bool_]  # rows in which it is not empty
    flaw: str = ""  # why it cannot be used
    unit: str = ""  # as the file names it
    label: str = ""  # of the signal, as it stands beside the numbers
    since: str = ""  # date and time of which the values tell the distance

    @property
    def bare_name(self) -> str:
        """The name of the signal, or the column's without a known unit in brackets behind it."""
        named = NAMED_UNIT.fullmatch(self.name)
        return self.label or (named["name"] if named and named["unit"].lower() in UNITS else self.name)


def read(path: Path, notes: list[str]) -> list[Column]:
    """Columns of a log; one that cannot be used is there with its flaw.

    ``notes``: what is left out. Raises BagError without any numbers, OSError if the file cannot be read.
    """
    return KINDS[path.suffix.lower()][1](path, notes)


# Text


def _text(path: Path, notes: list[str]) -> list[Column]:
    """Decimals have a point, or a comma where the separator is another.

    An incomplete last line, of a logger that was killed or of its closing mark, and empty rows are left out.
    Rows can end with the last channel that still has values, as those of TwinCAT Scope.
    """
    data = path.read_bytes()
    if not data:
        raise BagError(f"{path} is empty")
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    lines, binary = text.splitlines(), "\0" in text
    del data, text
    head = [(i, line) for i, line in enumerate(lines[: 4 * HEAD], start=1) if line.strip()][:HEAD]
    found = [form for separator in SEPARATORS for form in (_first_row(head, separator),) if form]
    if binary or not found:
        raise BagError(f"{path} is no table of numbers: none of its first {HEAD} lines is a row of them")
    _, count, first, separator = max(found, key=lambda form: form[:2])
    above = [[cell.strip() for cell in _cells(line.lstrip("#% "), separator)] for _, line in head[:first]]
    begin = head[first][0]
    labview = next((cells for cells in above if cells[0] == "X_Value"), None)
    if labview is not None:  # of whose rows some only have the last cell, a remark
        begin, count = head[above.index(labview)][0] + 1, len(labview) - (labview[-1] == "Comment")
        more = [i for i, line in enumerate(lines[begin:], begin) if line.startswith("Channels")]
        if more:
            notes.append(f"from line {more[0] + 1} on there are more segments, which are left out")
            del lines[more[0] :]
    while not lines[-1].strip() or lines[-1].startswith(COMMENTS):
        lines.pop()
    ends = (len(_cells(line, separator)) for line in lines[max(begin - 1, len(lines) - 2) :])
    *_, before, last = (count, count, *ends)
    if last < before:
        notes.append(f"line {len(lines)}, the last one, has {last} of {before} entries and is left out")
        lines.pop()
    columns = [_Cells(separator) for _ in range(count)]
    width, short, empty = count, begin, 0  # of the rows so far, since which line, and rows without a value
    plain = separator == "," or not any("," in line for line in lines[begin - 1 :])
    for start in range(begin - 1, len(lines), ROWS):
        if plain and width == count and _take_numbers(columns, lines[start : start + ROWS], separator):
            continue
        numbers, rows = [], []
        for number, line in enumerate(lines[start : start + ROWS], start + 1):
            if line.startswith(COMMENTS) or not line.strip(" \t,;"):
                empty += bool(line.strip()) and not line.startswith(COMMENTS)
                continue
            row = _cells(line, separator)[: count if labview else None]
            if len(row) > width:
                at, has = (number, len(row)) if width == count else (short, width)
                raise BagError(
                    f"{path}: line {at} has {has} entries, line {begin} has {count}; all rows need the same "
                    "number"
                )
            if len(row) < width:
                width, short = len(row), number
            numbers.append(number)
            rows.append(row if len(row) == count else [*row, *[""] * (count - len(row))])
        for column, cells in zip(columns, zip(*rows, strict=True), strict=False):
            column.take(cells, numbers)
    if empty:
        notes.append(f"{empty} empty rows are left out")
    found_columns = [
        column.result(name, unit, at)
        for at, (column, name, unit) in enumerate(zip(columns, *_names(above, count), strict=True), start=1)
    ]
    if labview is not None and not found_columns[0].filled.any():
        begins, steps = (
            next((_number(cells[1], separator) for cells in above if cells[0] == key), np.nan)
            for key in ("X0", "Delta_X")
        )
        times = begins + steps * np.arange(len(found_columns[0].values), dtype=np.float64)
        found_columns[0] = Column("X_Value", times, np.isfinite(times), unit="s")
    return _with_dates(found_columns)


def _take_numbers(columns: Sequence["_Cells"], lines: Sequence[str], separator: str) -> bool:
    """Take all of ``lines`` into the ``columns`` if they hold nothing but numbers."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of lines without data
            delimiter = None if separator == " " else separator
            values = np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)
    except (ValueError, UserWarning):
        return False
    if values.shape != (len(lines), len(columns)):
        return False
    for column, numbers in zip(columns, values.T, strict=True):
        column.take_numbers(numbers)
    return True


def _cells(line: str, separator: str) -> list[str]:
    if '"' not in line:
        return line.split(None if separator == " " else separator)
    text = line.strip() if separator == " " else line
    try:
        return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a cell is longer than csv takes, so no number
        return text.split(separator)


def _number(cell: str, separator: str) -> float:
    """The number in a cell. Raises ValueError."""
    if "_" in cell or cell.endswith(","):
        raise ValueError
    return float(cell.replace(",", ".") if separator != "," and "." not in cell else cell)


def _is_number(cell: str, separator: str) -> bool:
    try:
        _number(cell, separator)
    except ValueError:
        return bool(cell) and STAMP.fullmatch(cell) is not None
    return True


def _first_row(lines: Sequence[tuple[int, str]], separator: str) -> tuple[float, int, int, str] | None:
    """Share of numbers and number of cells of the first row, its index, and the separator.

    It is the first of the lines that have the most numbers, half of the cells at least (beside empty ones,
    more than half of the others). The two rows behind it have as many cells. What stands directly above it
    and has mostly numbers belongs to it.
    """
    best, rows = None, []
    for at, (number, line) in enumerate(lines):
        if line.startswith(COMMENTS):
            continue
        cells = [cell.strip() for cell in _cells(line, separator)]
        filled = [cell for cell in cells if cell.lower() not in MISSING]
        share = sum(_is_number(cell, separator) for cell in filled) / max(1, len(filled))
        usable = share > 0.5 or (share == 0.5 and filled == cells)
        rows.append((share if usable else 0.0, len(cells), at, number))
    for i, (share, count, _, _) in enumerate(rows):
        alike = all(row[1] == count for row in rows[i : i + 3])
        if share and alike and (best is None or (share, count) > rows[best][:2]):
            best = i
    if best is None:
        return None
    share, count, _, _ = rows[best]
    while (
        best and rows[best - 1][0] and rows[best - 1][1] == count and rows[best][3] - rows[best - 1][3] == 1
    ):
        best -= 1
    return share, count, rows[best][2], separator


def _names(above: Sequence[list[str]], count: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns by the lines above the first row.

    Units stand in brackets behind the names, or in a line of their own below them, with or without brackets.
    TwinCAT Scope and LabVIEW name their lines; TwinCAT also the columns of times.
    """
    fitting = [cells[:count] for cells in above if len(cells) >= count and not any(cells[count + 1 :])]
    named = {cells[0]: cells for cells in reversed(fitting)}
    units = [""] * count
    if "SampleTime[ms]" in named and "Name" in named:
        times = [cell == "Name" for cell in named["Name"]]
        listed = [cell.partition(" ")[0].strip("()") for cell in named.get("Unit", units)]
        units = ["ms" if time else unit * (unit != "None") for time, unit in zip(times, listed, strict=True)]
        return ["Time" if time else name for time, name in zip(times, named["Name"], strict=True)], units
    if "X_Value" in named:
        return named["X_Value"], ["", *named.get("Y_Unit_Label", units)[1:]]
    if len(fitting) > 1:
        last = [cell.strip("[]() ") for cell in fitting[-1]]
        if all(cell[:1] in "[(" for cell in fitting[-1]) or all(cell.lower() in UNITS for cell in last):
            units = last
            fitting.pop()
    names = fitting[-1] if fitting else [""] * count
    behind = [NAMED_UNIT.fullmatch(name) for name in names]
    return names, [
        unit or (named["unit"] if named else "") for unit, named in zip(units, behind, strict=True)
    ]


class _Cells:
    """Takes the numbers, or the dates and times, out of the cells of one column, piece by piece."""

    def __init__(self, separator: str) -> None:
        self._separator = separator
        self._pieces: list[npt.NDArray[Any]] = [np.empty(0, dtype=np.int64)]
        self._filled: list[npt.NDArray[np.bool_]] = [np.empty(0, dtype=np.bool_)]
        self._first = ""  # cell that is not empty
        self._comma, self._point, self._thousands = "", False, True
        self._flaw = ""

    def take_numbers(self, values: Floats) -> None:
        """Take ``values``, which stand there as plain numbers."""
        self._first = self._first or "0"
        self._pieces.append(values.copy())
        self._filled.append(np.ones(len(values), dtype=np.bool_))

    def take(self, cells: Sequence[str], lines: Sequence[int]) -> None:
        """Take ``cells``, which stand in these ``lines``."""
        filled, values = np.ones(len(cells), dtype=np.bool_), np.full(len(cells), np.nan)
        text, plain = "".join(cells), cells
        self._first = self._first or next((c for c in map(str.strip, cells) if c.lower() not in MISSING), "")
        stamps = STAMP.fullmatch(self._first) is not None and self._first != ""
        if "," in text and self._separator != "," and not stamps:
            commas = [cell for cell in cells if "," in cell]
            self._comma = self._comma or commas[0]
            self._thousands = self._thousands and all(map(THOUSANDS.fullmatch, commas))
            plain = [cell.replace(",", ".") for cell in cells]
        self._point = self._point or "." in text
        try:
            if stamps or "_" in text:
                raise ValueError
            values = np.fromiter(map(float, plain), np.float64, len(cells))
        except ValueError:
            filled = np.array([cell.strip().lower() not in MISSING for cell in cells])
            values = np.zeros(len(cells), dtype=np.int64) if stamps else values
            for row in [] if self._flaw else np.flatnonzero(filled).tolist():
                cell = cells[row].strip()
                try:
                    values[row] = _nanoseconds(cell) if stamps else _number(cell, self._separator)
                except ValueError:
                    self._flaw = f"'{cell[:LONGEST]}' in line {lines[row]}, which is no number"
                    break
        self._pieces.append(values)
        self._filled.append(filled)

    def result(self, name: str, unit: str, at: int) -> Column:
        """The column ``at`` this place from 1; dates and times of day are in ns there."""
        values, filled = np.concatenate(self._pieces), np.concatenate(self._filled)
        found = STAMP.fullmatch(self._first) if self._first else None
        flaw = self._flaw
        if not flaw and found is not None:
            kind = "date" if not found[8] else "stamp" if found[1] or found[7] else "clock"
            return Column(name, values, filled, unit=kind, since=self._first)
        if self._comma and self._point:
            flaw = f"'{self._comma[:LONGEST]}', with a comma where others have a decimal point"
        elif self._comma and self._thousands:
            flaw = "commas, which may separate decimals or thousands"
        elif not self._first:
            flaw = "nothing"
        return Column(name, values, filled, f"column {name or at} holds {flaw}" if flaw else "", unit)


@functools.lru_cache
def _day(year: str, month: str, day: str) -> int:
    return (datetime.date(int(year), int(month), int(day)) - datetime.date(1970, 1, 1)).days * DAY


def _nanoseconds(cell: str) -> int:
    """Time [ns] of a date since 1970, of a time of day since midnight. Raises ValueError."""
    found = STAMP.fullmatch(cell)
    if not cell or found is None:
        raise ValueError
    year, _, month, day, german_day, german_month, german_year, *clock, fraction = found.groups()
    ns = int((fraction or "").ljust(9, "0")[:9])
    for part, size in zip(clock, (3600, 60, 1), strict=True):
        ns += int(part or 0) * size * 10**9
    if year or german_year:
        ns += _day(year or german_year, month or german_month, day or german_day)
    return ns


def _with_dates(columns: Sequence[Column]) -> list[Column]:
    """``columns`` with stamps as seconds from the first; a date beside a time of day belongs to it."""
    found = list(columns)
    for i, column in enumerate(columns):
        if not column.since or not column.filled.any():
            continue
        ns, since, flaw = column.values, column.since, ""
        beside = [one for one in (*columns[max(i - 1, 0) : i], *columns[i + 1 : i + 2]) if one.unit == "date"]
        if column.unit == "date":
            flaw = f"column {column.name or i + 1} holds dates without times"
        elif column.unit == "clock" and beside and beside[0].since:
            ns, since = ns + beside[0].values, f"{beside[0].since} {since}"
        elif column.unit == "clock":  # midnight begins the next day
            ns = ns + DAY * np.cumsum(np.diff(ns, prepend=ns[:1]) < -DAY // 2)
        seconds = (ns - ns[np.argmax(column.filled)]) * 1e-9
        found[i] = Column(column.name, seconds, column.filled, flaw, since=since)
    return found


# MATLAB


def _matlab(path: Path, notes: list[str]) -> list[Column]:
    """Vectors and columns of matrices: ``name``, ``structure.field``, ``cell(2)`` or ``matrix(:,3)``.

    A text Name or label in a structure is the name of the signals in it, as of ControlDesk and Simulink.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    content: dict[str, Any] = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                content = loadmat(path)
                needs = f"{path} has objects of MATLAB, such as timeseries"
                whole = not any(isinstance(value, MatlabOpaque) for value in content.values())
            except NotImplementedError:
                needs, whole = f"{path} is a MATLAB file of version 7.3 (HDF5)", False
            if not whole and find_spec("matio"):
                from matio import load_from_mat

                content, whole = load_from_mat(str(path)), True
    except Exception as error:  # the libraries raise what they meet
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BagError(f"{path} is not a MATLAB file that can be read: {reason}") from error
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    found = [column for name, value in variables.items() for column in _vectors(name, value)]
    if not whole:
        text = (
            f"{needs}, which needs the extra logs (pip install valve_control[logs], or save vectors with -v7)"
        )
        if not found:
            raise BagError(text)
        notes.append(text)
    if not found:
        has = ", ".join(f"{name} ({_kind(value)})" for name, value in variables.items())
        raise BagError(f"{path} has no vector of numbers; it has {has or 'no variables'}")
    return found


def _kind(value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return type(value).__name__
    return type(value.item()).__name__ if value.size == 1 else f"{value.dtype} array"


def _vectors(name: str, value: Any) -> Iterator[Column]:
    """Columns in a variable of MATLAB, as scipy and mat-io give it."""
    if hasattr(value, "properties"):  # an object
        value = value.properties
    elif hasattr(value, "items") and hasattr(value, "index"):  # a table or timetable
        times = value.index.to_numpy()
        own = {"Time": (times - times[0]) / np.timedelta64(1, "s")} if times.dtype.kind in "mM" else {}
        value = {**own, **{str(key): content.to_numpy() for key, content in value.items()}}
    if isinstance(value, np.ndarray):
        value = value.squeeze()
        if value.ndim == 0 and value.dtype.kind in "OV":
            value = value[()]
            if not isinstance(value, np.void):
                yield from _vectors(name, value)
                return
    if isinstance(value, np.void):
        value = {field: value[field] for field in value.dtype.names or ()}
    if isinstance(value, dict):
        yield from _fields(name, value)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "OV" and value.size:
        for i, content in enumerate(value.ravel(order="F"), start=1):
            yield from _vectors(f"{name}({i})", content)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biufc" and value.ndim and value.size:
        upright = value.ndim == 1 or value.shape[0] >= value.shape[1]
        for i, vector in enumerate([value] if value.ndim == 1 else value.T if upright else value, start=1):
            index = "" if value.ndim == 1 else f"(:,{i})" if upright else f"({i},:)"
            flaw = f"column {name}{index} holds complex numbers" if value.dtype.kind == "c" else ""
            numbers = np.zeros(len(vector)) if flaw else vector.astype(np.float64)
            yield Column(f"{name}{index}", numbers, np.ones(len(vector), dtype=np.bool_), flaw)


def _fields(name: str, fields: dict[str, Any]) -> Iterator[Column]:
    """Columns of a structure or an object, with the signal's name and unit that stand beside them."""
    plain = {field.rstrip("_"): content for field, content in fields.items() if content is not None}
    texts = {
        field.lower(): str(np.asarray(content).item())
        for field, content in plain.items()
        if np.asarray(content).dtype.kind in "UT" and np.asarray(content).size == 1
    }
    label, unit = (
        next(filter(None, map(texts.get, fields)), "")
        for fields in (("name", "label", "signalname", "blockname"), ("unit", "units"))
    )
    for field, content in plain.items():
        for column in _vectors(f"{name}.{field}", content):
            timed = TIME.fullmatch(column.name.rpartition(".")[2]) is not None
            yield column if timed else column._replace(label=column.label or label, unit=column.unit or unit)
    info = getattr(plain.get("TimeInfo"), "properties", {})
    if "Data" in plain and not np.size(plain.get("Time", [])) and info:  # evenly spaced
        start, step, count = (
            float(np.squeeze(info.get(f"{key}_", info.get(key, np.nan))))
            for key in ("Start", "Increment", "Length")
        )
        if np.isfinite([start, step, count]).all():
            times = start + step * np.arange(round(count), dtype=np.float64)
            yield Column(f"{name}.Time", times, np.ones(len(times), dtype=np.bool_))


# MDF


def _mdf(path: Path, notes: list[str]) -> list[Column]:
    """Channels of an ASAM MDF file, each group of them behind its times."""
    if not find_spec("asammdf"):
        raise BagError(f"{path} is an MDF file, which needs the extra logs (pip install valve_control[logs])")
    from asammdf import MDF

    found: list[Column] = []
    try:
        with MDF(path) as file:
            times = np.empty(0)
            for signal in file.iter_channels():
                if (
                    signal.samples.ndim != 1
                    or signal.samples.dtype.kind not in "biuf"
                    or not len(signal.samples)
                ):
                    continue
                filled = np.ones(len(signal.samples), dtype=np.bool_)
                if not np.array_equal(times, signal.timestamps):
                    times = signal.timestamps.astype(np.float64)
                    found.append(Column("time", times, filled, unit="s"))
                found.append(Column(signal.name, signal.samples.astype(np.float64), filled, unit=signal.unit))
    except Exception as error:  # the library raises what it meets
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BagError(f"{path} is not an MDF file that can be read: {reason}") from error
    if not found:
        raise BagError(f"{path} has no channel of numbers")
    return found


Reader = Callable[[Path, list[str]], list[Column]]
KINDS: dict[str, tuple[str, Reader]] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".lvm"), ("csv", _text)),
    ".mat": ("mat", _matlab),
    **dict.fromkeys((".mf4", ".mdf"), ("mdf", _mdf)),
}  # kind and reader by suffix
