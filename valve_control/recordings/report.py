# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes the result of a task on recordings once, for a terminal, as JSON, CSV and as an HTML page."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from valve_control.arrays import Floats
from valve_control.control.analysis import page
from valve_control.control.analysis.figures import Band, Plot
from valve_control.control.analysis.indices import Indices

BLACK, BLUE, RED, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"


class Table(NamedTuple):
    """Rows below their head."""

    head: Sequence[str]
    rows: Sequence[Sequence[Any]]


class Figure(NamedTuple):
    """Plots below each other with one horizontal axis."""

    plots: Sequence[Plot]
    x_title: str = "time [s]"
    logarithmic_x: bool = False
    marks: Sequence[float] = ()
    bands: Sequence[Band] = ()


class Notes(NamedTuple):
    """Sentences that are to be noticed."""

    texts: Sequence[str]


class Markup(str):
    """HTML as it is; other strings are sentences."""


Piece = Table | Figure | Notes | str


class Report(NamedTuple):
    """The result of a task in all forms in which it is written."""

    title: str
    lines: list[str]  # for a terminal
    about: dict[str, Any]  # for JSON
    sections: Mapping[str, Sequence[Piece]]  # of the page, by heading
    columns: dict[str, Floats] = {}  # for CSV, the time first

    @property
    def text(self) -> str:
        """For a terminal."""
        return "\n".join(self.lines)

    @property
    def html(self) -> str:
        """One self-contained page."""
        sections = {head: "".join(map(_html, pieces)) for head, pieces in self.sections.items() if pieces}
        return page.page(self.title, sections)


def _html(piece: Piece) -> str:
    match piece:
        case Table():
            return page.table(*piece)
        case Figure():
            plots, x_title, logarithmic_x, marks, bands = piece
            return page.figure(plots, x_title, logarithmic_x, marks=marks, bands=bands)
        case Notes():
            return page.notes(piece.texts)
        case Markup():
            return piece
    return page.notes([piece], "text")


def index_table(rows: list[tuple[str, str, Indices, str]]) -> Table:
    """Table of indices: name, law, I1-I5, remark."""
    return Table(
        ["", "law", "e_M [V]", "e_F [V]", "e_rms [V]", "u_rms [V]", "c_u", ""],
        [(name, law, *(f"{value:.4f}" for value in values), remark) for name, law, values, remark in rows],
    )


def noted(notes: Sequence[str]) -> list[str]:
    """Notes for a terminal."""
    return [f"note: {note}" for note in notes]
