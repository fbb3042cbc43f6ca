# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Builds one self-contained HTML page of tables and zoomable figures; it loads nothing from the network."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis.figures import COLOURS, Band, Plot

MARKS = 50  # vertical lines at most
POINTS = 8000  # of one line; more are drawn as the envelope of their extremes
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1c2530 }
body { margin: 2rem auto; max-width: 1200px; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #d5dbe1 }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums }
th, td { padding: .2rem .8rem; text-align: right; border-bottom: 1px solid #e8ecef } th { color: #5a6672 }
th:first-child, td:first-child { text-align: left } .note { color: #8a4b00 } .scroll { overflow-x: auto }
"""


def envelope(x: Floats, y: Floats, points: int = POINTS) -> tuple[Floats, Floats]:
    """Reduce the line (x, y) to at most ``points`` points that keep its extremes and gaps (NaN)."""
    if len(x) <= points:
        return x, y
    gaps = np.isnan(y)
    kept = 3 if gaps.any() else 2  # of a block
    width = -(-len(x) // (points // kept - 2))
    sought = [(y, np.inf, np.argmin), (y, -np.inf, np.argmax), (gaps, 0.0, np.argmax)]
    base = np.arange(0, len(x), width)
    index = [np.array([0, len(x) - 1])]
    for values, beyond, place in sought[:kept]:
        padded = np.full(len(base) * width, beyond)
        padded[: len(x)] = np.where(np.isnan(values), beyond, values)
        index.append(np.minimum(base + place(padded.reshape(-1, width), axis=1), len(x) - 1))
    chosen = np.unique(np.concatenate(index))
    return x[chosen], y[chosen]


def figure(
    plots: Sequence[Plot],
    x_title: str,
    logarithmic_x: bool = False,
    height: int = 220,
    marks: Sequence[float] = (),
    bands: Sequence[Band] = (),
) -> str:
    """Plots below each other with one horizontal axis, as HTML; ``marks`` are times of vertical lines.

    A line of one point is a ring.
    """
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    result = make_subplots(rows=len(plots), cols=1, shared_xaxes=True, vertical_spacing=0.12 / len(plots))
    named: set[str] = set()
    for row, plot in enumerate(plots, start=1):
        for i, line in enumerate(plot.lines):
            x, y = envelope(line.x, line.y)
            style: dict[str, Any] = {"width": 1.2, "color": line.colour or COLOURS[i % len(COLOURS)]}
            if line.style == "--":
                style["dash"] = "dash"
            ring = {"size": 14, "symbol": "circle-open", "line": {"width": 2.5}, "color": style["color"]}
            result.add_trace(
                go.Scatter(
                    x=x, y=y.astype(np.float32), name=line.label, line=style, legendgroup=line.label,
                    showlegend=line.label not in named, marker=ring if len(x) == 1 else None,
                ),
                row=row,
                col=1,
            )  # fmt: skip
            named.add(line.label)
        result.update_yaxes(
            title_text=plot.title, type="log" if plot.logarithmic else "linear", row=row, col=1
        )
    for mark in marks[:MARKS]:
        result.add_vline(x=mark, line={"width": 1, "dash": "dot", "color": "#8a4b00"})
    result.update_layout(shapes=[*result.layout.shapes, *map(_shape, bands)])
    result.update_xaxes(type="log" if logarithmic_x else "linear")
    result.update_xaxes(title_text=x_title, row=len(plots), col=1)
    result.update_layout(
        template="plotly_white", margin={"l": 70, "r": 20, "t": 80, "b": 50}, hovermode="x unified",
        height=height * len(plots) + 140, legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"},
    )  # fmt: skip
    return str(result.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False}))


def _shape(band: Band) -> dict[str, Any]:
    """A band as a shape of plotly; its edge makes it visible where it is narrower than a pixel."""
    return {
        "type": "rect", "layer": "below", "xref": "x", "x0": band.start, "x1": band.end,
        "yref": "paper", "y0": 0.0, "y1": 1.0, "fillcolor": band.colour, "opacity": 0.2,
        "line": {"width": 1, "color": band.colour},
    }  # fmt: skip


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table as HTML."""
    cells = "".join(f"<th>{html.escape(word)}</th>" for word in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f'<div class="scroll"><table><tr>{cells}</tr>{body}</table></div>'


def notes(texts: Sequence[str], kind: str = "note") -> str:
    """Sentences as HTML, one below the other: a ``note`` is to be noticed, a ``text`` is not."""
    return "".join(f'<p class="{kind}">{html.escape(text)}</p>' for text in texts)


def page(title: str, sections: Mapping[str, str]) -> str:
    """The whole page as HTML; ``sections`` are pieces of HTML by heading."""
    from plotly.offline import get_plotlyjs

    body = "".join(f"<h2>{html.escape(name)}</h2>\n{content}\n" for name, content in sections.items())
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{STYLE}</style>\n<script>{get_plotlyjs()}</script></head>\n"
        f"<body><h1>{html.escape(title)}</h1>\n{body}</body></html>\n"
    )
