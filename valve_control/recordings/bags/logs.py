# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads logs as columns of numbers: text (CSV, TwinCAT Scope, LabVIEW), MATLAB's .mat and ASAM's MDF.

MATLAB's objects and version 7.3 are read with mat-io, MDF with asammdf: both are the extra ``logs``.
"""

import csv
import functools
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.recordings.bags.errors import BagError

SEPARATORS = (";", "\t", ",", " ")
HEAD = 50  # lines among which the first row of numbers is
COMMENTS = ("#", "%")
MISSING = {"", "na", "n/a", "null"}
THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*")
DECIMAL_COMMA = re.compile(r"\s*[+-]?(0,\d+|\d+,(\d\d?|\d{4,}))\s*")
UNITS = {
    **{"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    **{"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "uv": 1e-6, "µv": 1e-6, "kv": 1e3},
    **{"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9},
}  # in lower case, in s or V
NAMED_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(]\s*(?P<unit>%|[^\W\d][^\])]*?)\s*[\])]")
TIME = re.compile(
    r"(?:time|t|zeit|x_value|(?P<stamp>(?:time)?stamp))"
    r"(?:[\s_]*[\[(]\s*|[\s_]+|$)(?P<unit>s|sec|ms|us|µs|ns|)\s*[\])]?",
    re.IGNORECASE,
)  # a usual name of a time
STAMP = re.compile(
    r"(?=\d)(?:(\d{4})([-/.])(\d\d?)\2(\d\d?)|(\d\d?)\.(\d\d?)\.(\d{4}))?"
    r"(?:(?:^|[T ,;])\s*(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?)?(?:Z|[+-]\d\d:?\d\d)?"
)  # date, time of day, or both; zones are not regarded
DAY = 86_400  # s
EXTRA = "pip install valve_control[logs]"
LONGEST = 40  # characters of a cell that are shown


class Column(NamedTuple):
    """A column of a table."""

    name: str  # "" without header; of a MATLAB file the path of a vector
    values: Floats  # NaN where it is empty
    flaw: str = ""  # why it cannot be used
    unit: str = ""  # as the file names it
    label: str = ""  # of the signal, as it stands beside the numbers
    since: str = ""  # date and time of which the values tell the distance

    @property
    def bare_name(self) -> str:
        """The name of the signal, or the column's without a unit in brackets behind it, in () a known one."""
        named = NAMED_UNIT.fullmatch(self.name)
        unit = named is not None and (self.name.endswith("]") or named["unit"].lower() in UNITS)
        return self.label or (named["name"] if named and unit else self.name)


def read(path: Path, notes: list[str]) -> list[Column]:
    """Columns of a log; one that cannot be used is there with its flaw.

    ``notes``: what is left out. Raises BagError without any numbers, OSError if the file cannot be read.
    """
    kind, reader = KINDS[path.suffix.lower()]
    try:
        return reader(path, notes)
    except (BagError, OSError, MemoryError):
        raise
    except Exception as error:  # the libraries raise what they meet
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BagError(f"{path} is not a {kind} file that can be read: {reason}") from error


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
    forms = [form for separator in SEPARATORS for form in (_first_row(head, separator),) if form]
    if binary or not forms:
        raise BagError(f"{path} is no table of numbers: none of its first {HEAD} lines is a row of them")
    _, count, first, separator = max(forms, key=lambda form: form[:2])
    above = [[cell.strip() for cell in _cells(line.lstrip("#% "), separator)] for _, line in head[:first]]
    begin = head[first][0]
    labview = next((cells for cells in above if cells[:1] == ["X_Value"]), None)
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
    body = lines[begin - 1 :]
    if not any(line.strip(" \t,;") and not line.startswith(COMMENTS) for line in body):
        raise BagError(f"{path} has no row of numbers behind line {begin - 1}")
    names, units = _names(above, count)
    values = _plain(body, separator)
    if values is not None and values.shape[1] == count:
        found = [Column(*column) for column in zip(names, values.T.copy(), [""] * count, units, strict=True)]
    else:
        numbers, rows = _rows(path, body, begin, separator, count, labview is not None, notes)
        sure = separator != "," and any(DECIMAL_COMMA.fullmatch(cell) for row in rows for cell in row)
        columns = enumerate(zip(names, units, zip(*rows, strict=True), strict=True), 1)
        found = [_column(at, *column, numbers, separator, sure) for at, column in columns]
    header = dict(cells[:2] for cells in above if len(cells) > 1)
    if labview is not None and np.isnan(found[0].values).all():
        with suppress(KeyError, ValueError):  # there are no times then
            begins, step = (_number(header[key], separator) for key in ("X0", "Delta_X"))
            times = begins + step * np.arange(len(found[0].values), dtype=np.float64)
            found[0] = Column("X_Value", times, unit="s")
    return _with_dates(found)


def _plain(lines: Sequence[str], separator: str) -> Floats | None:
    """What ``lines`` hold if they are nothing but rows of numbers, None otherwise."""
    try:
        delimiter = None if separator == " " else separator
        return np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None


def _rows(
    path: Path, lines: Sequence[str], begin: int, separator: str, count: int, cut: bool, notes: list[str]
) -> tuple[list[int], list[list[str]]]:
    """Numbers of the lines from ``begin`` on, and their cells, without remarks and empty rows.

    Rows can end with the last channel that has values; ``cut``: they can have more cells than ``count``.
    Raises BagError for others.
    """
    numbers, rows = [], []
    width, short, empty = count, begin, 0  # of the rows so far, since which line, and rows without a value
    for number, line in enumerate(lines, begin):
        if line.startswith(COMMENTS) or not line.strip(" \t,;"):
            empty += bool(line.strip()) and not line.startswith(COMMENTS)
            continue
        row = _cells(line, separator)[: count if cut else None]
        if len(row) > width:
            at, has = (number, len(row)) if width == count else (short, width)
            raise BagError(
                f"{path}: line {at} has {has} entries, line {begin} has {count}; "
                "all rows need the same number"
            )
        if len(row) < width:
            width, short = len(row), number
        numbers.append(number)
        rows.append(row if len(row) == count else [*row, *[""] * (count - len(row))])
    if empty:
        notes.append(f"{empty} empty rows are left out")
    return numbers, rows


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
        return STAMP.fullmatch(cell) is not None
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
    named = {cells[0]: cells for cells in fitting}
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
        if (
            all(cell[:1] in "[(" for cell in fitting[-1])
            or 2 * sum(cell.lower() in UNITS for cell in last) > count
        ):
            units = last
            fitting.pop()
    names = fitting[-1] if fitting else [""] * count
    behind = [NAMED_UNIT.fullmatch(name) for name in names]
    return names, [
        unit or (named["unit"] if named else "") for unit, named in zip(units, behind, strict=True)
    ]


def _column(
    at: int, name: str, unit: str, cells: Sequence[str], lines: Sequence[int], separator: str, decimal: bool
) -> Column:
    """The column at this place from 1, of ``cells`` in ``lines``; ``decimal``: commas separate decimals."""
    first = next((cell for cell in map(str.strip, cells) if cell.lower() not in MISSING), "")
    stamp = STAMP.fullmatch(first)
    commas = [cell for cell in cells if "," in cell] if separator != "," and stamp is None else []
    flaw = "" if first else "nothing"
    if commas and any("." in cell for cell in cells):
        flaw = f"'{commas[0][:LONGEST]}', with a comma where others have a decimal point"
    elif commas and not decimal and all(map(THOUSANDS.fullmatch, commas)):
        flaw = "commas, which may separate decimals or thousands; write decimals with a point"
    values = np.full(len(cells), np.nan)
    for row, cell in enumerate(() if flaw else map(str.strip, cells)):
        if cell.lower() in MISSING:
            continue
        try:
            values[row] = (
                (_nanoseconds(cell) - _nanoseconds(first)) * 1e-9 if stamp else _number(cell, separator)
            )
        except ValueError:
            flaw = f"'{cell[:LONGEST]}' in line {lines[row]}, which is no number"
            break
    if stamp and not flaw:
        kind = "date" if not stamp[8] else "stamp" if stamp[1] or stamp[7] else "clock"
        return Column(name, values, unit=kind, since=first)
    return Column(name, values, f"column {name or at} holds {flaw}" if flaw else "", unit)


@functools.lru_cache
def _nanoseconds(cell: str) -> int:
    """Time [ns] of a date since 1970, of a time of day since midnight. Raises ValueError."""
    found = STAMP.fullmatch(cell)
    if found is None:
        raise ValueError
    year, _, month, day, german_day, german_month, german_year, *clock, fraction = found.groups()
    ns = int((fraction or "").ljust(9, "0")[:9])
    for part, size in zip(clock, (3600, 60, 1), strict=True):
        ns += int(part or 0) * size * 10**9
    if year or german_year:
        date = f"{year or german_year}-{month or german_month:0>2}-{day or german_day:0>2}"
        ns += int(np.datetime64(date, "D").astype(np.int64)) * DAY * 10**9
    return ns


def _with_dates(columns: Sequence[Column]) -> list[Column]:
    """``columns`` with stamps as seconds from the first; a date beside a time of day belongs to it."""
    found = list(columns)
    for i, column in enumerate(columns):
        seconds, since, flaw = column.values, column.since, ""
        dates = [one for one in (*columns[max(i - 1, 0) : i], *columns[i + 1 : i + 2]) if one.unit == "date"]
        if not since:
            continue
        if column.unit == "date":
            flaw = f"column {column.name or i + 1} holds dates without times"
        elif column.unit == "clock" and dates and dates[0].since:
            seconds, since = seconds + dates[0].values, f"{dates[0].since} {since}"
        elif column.unit == "clock":  # midnight begins the next day
            seconds = seconds + DAY * np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -0.5 * DAY)
        found[i] = Column(column.name, seconds, flaw, since=since)
    return found


# MATLAB


def _matlab(path: Path, notes: list[str]) -> list[Column]:
    """Vectors and columns of matrices: ``name``, ``structure.field``, ``cell(2)`` or ``matrix(:,3)``.

    A text Name or label in a structure is the name of the signals in it, as of ControlDesk and Simulink.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    content: dict[str, Any] = {}
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
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    found = [column for name, value in variables.items() for column in _vectors(name, value)]
    if not whole:
        text = f"{needs}, which needs the extra logs ({EXTRA}, or save vectors with -v7)"
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
        upright = value.ndim > 1 and value.shape[0] >= value.shape[1]
        for i, vector in enumerate(np.atleast_2d(value.T if upright else value), start=1):
            path = name if value.ndim == 1 else f"{name}(:,{i})" if upright else f"{name}({i},:)"
            flaw = f"column {path} holds complex numbers" if value.dtype.kind == "c" else ""
            yield Column(path, vector.real.astype(np.float64), flaw)


def _fields(name: str, fields: dict[str, Any]) -> Iterator[Column]:
    """Columns of a structure or an object, with the signal's name and unit that stand beside them."""
    plain = {field.rstrip("_"): content for field, content in fields.items() if content is not None}
    texts = {
        field.lower(): str(text.item())
        for field, text in zip(plain, map(np.asarray, plain.values()), strict=True)
        if text.dtype.kind in "UT" and text.size == 1
    }
    label = next(filter(None, map(texts.get, ("name", "label", "signalname", "blockname"))), "")
    unit = texts.get("unit", texts.get("units", ""))
    for field, content in plain.items():
        for column in _vectors(f"{name}.{field}", content):
            timed = TIME.fullmatch(column.name.rpartition(".")[2]) is not None
            yield column if timed else column._replace(label=column.label or label, unit=column.unit or unit)
    info = getattr(plain.get("TimeInfo"), "properties", {})
    if (
        "Data" in plain
        and not np.size(plain.get("Time", []))
        and {"Start_", "Increment_", "Length"} <= set(info)
    ):
        start, step, count = (float(np.squeeze(info[key])) for key in ("Start_", "Increment_", "Length"))
        yield Column(f"{name}.Time", start + step * np.arange(count, dtype=np.float64))  # evenly spaced


# MDF


def _mdf(path: Path, notes: list[str]) -> list[Column]:
    """Channels of an ASAM MDF file, each group of them behind its times."""
    if not find_spec("asammdf"):
        raise BagError(f"{path} is an MDF file, which needs the extra logs ({EXTRA})")
    from asammdf import MDF

    found: list[Column] = []
    with MDF(path) as file:
        times = np.empty(0)
        for signal in file.iter_channels():
            if signal.samples.ndim == 1 and signal.samples.dtype.kind in "biuf" and len(signal.samples):
                if not np.array_equal(times, signal.timestamps):
                    times = signal.timestamps.astype(np.float64)
                    found.append(Column("time", times, unit="s"))
                found.append(Column(signal.name, signal.samples.astype(np.float64), unit=signal.unit))
    if not found:
        raise BagError(f"{path} has no channel of numbers")
    return found


Reader = Callable[[Path, list[str]], list[Column]]
KINDS: dict[str, tuple[str, Reader]] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".lvm"), ("csv", _text)),
    ".mat": ("MATLAB", _matlab),
    **dict.fromkeys((".mf4", ".mdf"), ("MDF", _mdf)),
}  # kind and reader by suffix
