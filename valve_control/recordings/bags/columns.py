# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads columns of numbers out of a text: any usual separator, decimal point or comma, header or none."""

import contextlib
import csv
import itertools
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.recordings.bags.errors import BagError

SEPARATORS = (";", "\t", ",", None)  # None: white space
HEAD = 300  # lines that tell of what form a text is
HEAD_BYTES = 1 << 16
COMMENTS = ("#", "%")
MISSING = {"", "na", "n/a", "null"}
UNIT = re.compile(r"[(\[].*[)\]]")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
LONGEST = 40  # characters of a cell that are shown


class Column(NamedTuple):
    """A column of a table."""

    name: str  # "" without header
    values: Floats
    filled: npt.NDArray[np.bool_]  # rows in which it is not empty
    flaw: str = ""  # why it cannot be used


class _Form(NamedTuple):
    """Form of a text: its separator, the names of its columns, the line of its first row."""

    separator: str | None
    names: tuple[str, ...]
    first: int


def read(path: Path) -> list[Column]:
    """Columns of a text file; one with a cell that is no number is there with its flaw.

    Raises BagError without any numbers and where rows have not the same number of entries, OSError if the
    file cannot be read.
    """
    encoding = _encoding(path)
    form = _form(list(itertools.islice(_lines(path, encoding), HEAD)))
    if form is None:
        raise BagError(f"{path} is no table of numbers: none of its first {HEAD} lines is a row of them")
    count = len(form.names)
    cells = [_Cells() for _ in range(count)]
    adds = [one.add for one in cells]
    for number, line, comment in _lines(path, encoding):
        if number < form.first or comment:
            continue
        row = _split(line, form.separator)
        if len(row) != count:
            raise BagError(
                f"{path}: line {number} has {len(row)} entries, line {form.first} has {count}; all rows need "
                "the same number"
            )
        for add, cell in zip(adds, row, strict=True):
            add(number, cell)
    return [one.column(name, k) for k, (name, one) in enumerate(zip(form.names, cells, strict=True), start=1)]


class _Cells:
    """Numbers of one column, row by row, up to the first cell that is none."""

    def __init__(self) -> None:
        self._numbers = array("d")
        self._empty: list[int] = []
        self._comma = 0  # line of the first decimal comma, 0 before it
        self._plain = False  # whether one of them can be nothing else
        self._flaw = ""

    def add(self, line: int, cell: str) -> None:
        """Take the cell of the next row, which stands in ``line``."""
        try:
            if self._comma or "_" in cell:
                raise ValueError
            self._numbers.append(float(cell))
        except ValueError:
            if not self._flaw:
                self._unusual(line, cell)

    def _unusual(self, line: int, cell: str) -> None:
        if cell.lower() in MISSING:
            self._empty.append(len(self._numbers))
            self._numbers.append(np.nan)
            return
        sound = "." not in cell and "_" not in cell and not cell.endswith(",")
        number = cell.replace(",", ".") if sound else ""
        try:
            value = float(number)
        except ValueError:
            shown = cell if len(cell) <= LONGEST else f"{cell[:LONGEST]}…"
            self._flaw = f"'{shown}' in line {line}, which is no number"
            return
        if "," in cell:
            if not self._comma and any(before % 1.0 for before in self._numbers if np.isfinite(before)):
                self._flaw = f"'{cell}' in line {line}, with a comma where others have a decimal point"
                return
            self._comma = self._comma or line
            self._plain = self._plain or not THOUSANDS.fullmatch(cell)
        self._numbers.append(value)

    def column(self, name: str, number: int) -> Column:
        """The column ``name`` of these cells, the ``number``-th of its table."""
        values = np.frombuffer(self._numbers, dtype=np.float64) if self._numbers else np.empty(0)
        filled = np.ones(len(values), dtype=np.bool_)
        filled[self._empty] = False
        flaw = self._flaw
        if not flaw and self._comma and not self._plain:
            flaw = f"commas from line {self._comma} on, which may separate decimals or thousands"
        if not flaw and not filled.any():
            flaw = "nothing"
        return Column(name, values, filled, f"column {name or number} holds {flaw}" if flaw else "")


def _encoding(path: Path) -> str:
    with path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
    if not head:
        raise BagError(f"{path} is empty")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in head:
        raise BagError(f"{path} is no text, so no table of numbers")
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 4:
            return "latin-1"
    return "utf-8-sig"


def _lines(path: Path, encoding: str) -> Iterator[tuple[int, str, bool]]:
    """Lines with content, with their numbers from 1, and whether they are comments, without their marks."""
    with path.open(encoding=encoding, errors="replace") as stream:
        for number, line in enumerate(stream, start=1):
            text = line.rstrip("\n")
            if text.startswith(COMMENTS):
                yield number, text.lstrip("".join(COMMENTS)).strip(), True
            elif text and not text.isspace():
                yield number, text, False


def _split(line: str, separator: str | None) -> list[str]:
    if '"' in line:
        reader = csv.reader([line.strip() if separator is None else line], delimiter=separator or " ",
                            skipinitialspace=True)  # fmt: skip
        with contextlib.suppress(csv.Error):  # a cell is longer than csv takes, so no number
            return [cell.strip() for cell in next(reader)]
    return line.split() if separator is None else [cell.strip() for cell in line.split(separator)]


def _is_number(cell: str, comma: bool) -> bool:
    try:
        float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return False
    return not (comma and cell.endswith(","))


def _form(head: Sequence[tuple[int, str, bool]]) -> _Form | None:
    """The most likely form of a text that begins with the lines ``head``, None if it has no numbers."""
    best: tuple[tuple[int, bool, int, int], _Form] | None = None
    for separator in SEPARATORS:
        found = _form_by(separator, head)
        if found is not None and (best is None or found[0] > best[0]):
            best = found
    return None if best is None else best[1]


def _form_by(
    separator: str | None, head: Sequence[tuple[int, str, bool]]
) -> tuple[tuple[int, bool, int, int], _Form] | None:
    """Form of a text with this ``separator`` and how well it fits, None if it cannot have it."""
    lines = [(number, _split(line, separator), comment) for number, line, comment in head]
    counts = Counter(len(cells) for _, cells, comment in lines if not comment)
    if not counts:
        return None
    count = max(counts, key=lambda size: (counts[size], size))
    usual = [(number, cells) for number, cells, comment in lines if len(cells) == count and not comment]
    kinds = [
        [None if cell.lower() in MISSING else _is_number(cell, separator != ",") for cell in cells]
        for _, cells in usual
    ]
    told = [[kind for kind in column if kind is not None] for column in zip(*kinds, strict=True)]
    numeric = tuple(k for k, column in enumerate(told) if sum(column) >= max(1.0, 0.5 * len(column)))
    rows = [sum(row[k] is True for k in numeric) for row in kinds]
    # More than half of a row are numbers; a line such as "interval,0.001" is of the head.
    least = 0.5 * min(len(numeric), max(rows, default=0))
    begin = next((i for i, numbers in enumerate(rows) if numbers > least), None)
    if begin is None:
        return None
    first = usual[begin][0]
    above = [cells for number, cells, _ in lines if number < first]
    names = _names(above, count)
    sound = sum(all(row[k] is not False for k in numeric) for row in kinds[begin:])
    texts = sum(any(row[k] is False for row in kinds[begin:]) for k in range(count) if k not in numeric)
    fit = (sound, any(names) or not above, -texts, len(numeric))
    return fit, _Form(separator, names, first)


def _names(above: Sequence[Sequence[str]], count: int) -> tuple[str, ...]:
    """Names of the ``count`` columns by the lines above the first row, the last of which may be units."""
    fitting = []
    for cells in reversed(above):
        padded = [*cells, ""] if len(cells) == count - 1 else list(cells)
        if len(padded) == count + 1 and not padded[-1]:
            padded.pop()
        if len(padded) != count:
            break
        fitting.append(padded)
    if len(fitting) > 1 and all(UNIT.fullmatch(cell) for cell in fitting[0] if cell):
        fitting.pop(0)
    return tuple(fitting[0]) if fitting else ("",) * count
