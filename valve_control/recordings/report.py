# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes the result of a task on recordings once, for a terminal, as JSON, CSV and as an HTML page."""

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import page
from valve_control.control.analysis.figures import Band, Line, Plot
from valve_control.control.analysis.indices import Indices

BLACK, BLUE, RED, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"


class Table(NamedTuple):
    """Rows below their head, of which a terminal shows at most ``most``."""

    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    most: int | None = None


class Figure(NamedTuple):
    """Plots below each other with one horizontal axis, for the page alone."""

    plots: Sequence[Plot]
    x_title: str = "time [s]"
    logarithmic_x: bool = False
    marks: Sequence[float] = ()
    bands: Sequence[Band] = ()


class Notes(NamedTuple):
    """Sentences that are to be noticed."""

    texts: Sequence[str]


class Aside(NamedTuple):
    """Pieces for the page alone, folded below their ``summary``."""

    summary: str
    pieces: "Sequence[Piece]"


Piece = Table | Figure | Notes | Aside | str


class Report(NamedTuple):
    """The result of a task in all forms in which it is written."""

    title: str
    about: dict[str, Any]  # for JSON
    sections: Mapping[str, Sequence[Piece]]  # by heading
    columns: dict[str, Floats] = {}  # for CSV, the time first

    @property
    def text(self) -> str:
        """For a terminal."""
        sections = ((head, [*_lines(pieces)]) for head, pieces in self.sections.items())
        return "\n\n".join("\n".join([head, *lines]) for head, lines in sections if lines)

    @property
    def html(self) -> str:
        """One self-contained page."""
        sections = {head: "".join(map(_html, pieces)) for head, pieces in self.sections.items() if pieces}
        return page.page(self.title, sections)


def _lines(pieces: Sequence[Piece]) -> Iterator[str]:
    for piece in pieces:
        match piece:
            case Table(head, rows, most):
                cells = [[str(cell) for cell in row] for row in (head, *rows[:most])]
                widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
                for first, *rest in cells:
                    numbers = [f"  {cell:>{width}}" for cell, width in zip(rest, widths[1:], strict=True)]
                    last = f"  {rest[-1]}" if rest else ""  # which may be a sentence
                    yield (f"{first:<{widths[0]}}" + "".join(numbers[:-1]) + last).rstrip()
                if len(rows) + 1 > len(cells):
                    yield f"({len(rows) + 1 - len(cells)} more in --json and --html)"
            case Notes(texts):
                yield from (f"note: {text}" for text in texts)
            case str():
                yield piece


def _html(piece: Piece) -> str:
    match piece:
        case Table(head, rows):
            return page.table(head, rows)
        case Figure(plots, x_title, logarithmic_x, marks, bands):
            return page.figure(plots, x_title, logarithmic_x, marks=marks, bands=bands)
        case Notes(texts):
            return page.notes(texts)
        case Aside(summary, pieces):
            inner = "".join(map(_html, pieces))
            return f"<details><summary>{html.escape(summary)}</summary>{inner}</details>"
    return page.notes([piece], "text")


def index_table(rows: Sequence[tuple[str, str, Indices, str]], most: int | None = None) -> Table:
    """Table of indices: name, law, I1-I5, remark."""
    head = ["", "law", "e_M [V]", "e_F [V]", "e_rms [V]", "u_rms [V]", "c_u", ""]
    form = "{:.4f} {:.4f} {:.4f} {:.3f} {:.4f}"
    cells = [
        (name, law, *form.format(*v).replace("nan", "?").split(), remark) for name, law, v, remark in rows
    ]
    return Table(head, cells, most)


def plots_of(time: Floats, plots: Mapping[str, Sequence[tuple[str, Floats, str]]]) -> list[Plot]:
    """Plots by title: lines with label, values at ``time`` [s] and colour; without any number left out."""
    found = {
        title: [Line(label, time, y, colour) for label, y, colour in lines if np.isfinite(y).any()]
        for title, lines in plots.items()
    }
    return [Plot(title, lines) for title, lines in found.items() if lines]


def plain(value: Any) -> Any:
    """``value`` with records as dictionaries, for JSON."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: plain(entry) for name, entry in value.items()}
    return [plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value
