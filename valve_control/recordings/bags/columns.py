# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads columns of numbers out of a text: separated by ; tab , or spaces, with or without names above."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.recordings.bags.errors import BagError

SEPARATORS = (";", "\t", ",", " ")
HEAD = 50  # lines among which the first row of numbers is
COMMENTS = ("#", "%")
MISSING = {"", "na", "n/a", "null"}
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
UNITS = {
    **{"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    **{"v": 1.0, "mv": 1e-3, "uv": 1e-6, "µv": 1e-6, "kv": 1e3},
}  # in lower case, in s or V
NAMED_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\W\d][^\])]*?)\s*[\])]")
LONGEST = 40  # characters of a cell that are shown


class Column(NamedTuple):
    """A column of a table."""

    name: str  # "" without header
    values: Floats
    filled: npt.NDArray[np.bool_]  # rows in which it is not empty
    flaw: str = ""  # why it cannot be used
    unit: str = ""  # as it stands in the header

    @property
    def bare_name(self) -> str:
        """The name without a known unit in brackets behind it."""
        named = NAMED_UNIT.fullmatch(self.name)
        return named["name"] if named and named["unit"].lower() in UNITS else self.name


def read(path: Path, notes: list[str]) -> list[Column]:
    """Columns of a text file; one with a cell that is no number is there with its flaw.

    Decimals have a point, or a comma where the separator is another. An incomplete last line, of a logger
    that was killed or of its closing mark, and empty rows are left out, with ``notes``. Raises BagError
    without any numbers and where other rows have not the same number of entries, OSError if the file cannot
    be read.
    """
    data = path.read_bytes()
    if not data:
        raise BagError(f"{path} is empty")
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    lines = [(i, line.strip("\r\n")) for i, line in enumerate(text.splitlines(), start=1) if line.strip()]
    found = [form for separator in SEPARATORS for form in (_first_row(lines[:HEAD], separator),) if form]
    if "\0" in text or not found:
        raise BagError(f"{path} is no table of numbers: none of its first {HEAD} lines is a row of them")
    _, count, first, separator = max(found, key=lambda form: form[:2])
    above = [_cells(line.lstrip("#% "), separator) for _, line in lines[:first]]
    rows = [(i, _cells(line, separator)) for i, line in lines[first:] if not line.startswith(COMMENTS)]
    if len(rows) > 1 and len(rows[-1][1]) < count:
        number, row = rows.pop()
        notes.append(f"line {number}, the last one, has {len(row)} of {count} entries and is left out")
    whole = [(number, row) for number, row in rows if any(row)]
    if len(whole) < len(rows):
        notes.append(f"{len(rows) - len(whole)} empty rows are left out")
        rows = whole
    for number, row in rows:
        if len(row) != count:
            raise BagError(
                f"{path}: line {number} has {len(row)} entries, line {rows[0][0]} has {count}; all rows need "
                "the same number"
            )
    names, units = _names(above, count)
    cells = zip(*(row for _, row in rows), strict=True)
    numbers = [number for number, _ in rows]
    return [
        _column(names[k], k + 1, column, numbers, separator)._replace(unit=units[k])
        for k, column in enumerate(cells)
    ]


def _cells(line: str, separator: str) -> list[str]:
    if separator == " " and '"' not in line:
        return line.split()
    text = line.strip() if separator == " " else line
    try:
        row = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a cell is longer than csv takes, so no number
        row = text.split(separator)
    return [cell.strip() for cell in row]


def _number(cell: str, separator: str) -> float:
    """The number in a cell. Raises ValueError."""
    if "_" in cell or cell.endswith(","):
        raise ValueError
    return float(cell.replace(",", ".") if separator != "," and "." not in cell else cell)


def _is_number(cell: str, separator: str) -> bool:
    try:
        _number(cell, separator)
    except ValueError:
        return False
    return True


def _first_row(lines: Sequence[tuple[int, str]], separator: str) -> tuple[float, int, int, str] | None:
    """Share of numbers and number of cells of the first row, its index, and the separator.

    Half of its cells at least are numbers (beside empty ones, more than half of the others), and the two rows
    behind it have as many cells.
    """
    for at, (_, line) in enumerate(lines):
        cells = _cells(line, separator)
        filled = [cell for cell in cells if cell.lower() not in MISSING]
        share = sum(_is_number(cell, separator) for cell in filled) / max(1, len(filled))
        if not line.startswith(COMMENTS) and (share > 0.5 or (share == 0.5 and filled == cells)):
            rows = [row for _, row in lines[at:] if not row.startswith(COMMENTS)][:3]
            if all(len(_cells(row, separator)) == len(cells) for row in rows):
                return share, len(cells), at, separator
    return None


def _names(above: Sequence[list[str]], count: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns by the lines above the first row.

    Units stand in brackets behind the names, or in a line of their own below them, with or without brackets.
    """
    fitting = [cells for cells in above if len(cells) == count]
    units = [""] * count
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


def _column(name: str, at: int, cells: Sequence[str], lines: Sequence[int], separator: str) -> Column:
    filled = np.array([cell.lower() not in MISSING for cell in cells])
    values = np.full(len(cells), np.nan)
    flaw = "" if filled.any() else "nothing"
    commas = [cell for cell in cells if "," in cell] if separator != "," else []
    if commas and any("." in cell for cell in cells):
        flaw = f"'{commas[0][:LONGEST]}', with a comma where others have a decimal point"
    elif commas and all(map(THOUSANDS.fullmatch, commas)):
        flaw = "commas, which may separate decimals or thousands"
    for row in np.flatnonzero(filled).tolist():
        try:
            values[row] = _number(cells[row], separator)
        except ValueError:
            flaw = f"'{cells[row][:LONGEST]}' in line {lines[row]}, which is no number"
            break
    return Column(name, values, filled, f"column {name or at} holds {flaw}" if flaw else "")
