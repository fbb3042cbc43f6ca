# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes Table 1 and the figures as files and as one HTML page."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from research.paper import PAPER_TABLE_1
from research.paper.figures import Figure
from research.paper.runs import FEEDBACK
from research.paper.traces import Trace
from valve_control import outputs
from valve_control.control.analysis import page
from valve_control.control.analysis.figures import draw_columns
from valve_control.control.analysis.indices import Indices, indices

NEAR = 0.05  # relative deviation that counts as reproduced


def table_1(runs: Mapping[str, Trace]) -> dict[str, Any]:
    """Indices of PID, ARC and OARC beside the paper's, their ratios, and how near they are."""
    rows: dict[str, Any] = {}
    found = {}
    for name in FEEDBACK:
        run = runs[f"table1_{name}"]
        found[name] = indices(run.measurement - run.command, run.voltage, run.period)
        paper = PAPER_TABLE_1[name]
        rows[name] = {
            "indices": found[name]._asdict(),
            "paper": paper._asdict(),
            "ratio": {
                key: value / reference
                for key, value, reference in zip(Indices._fields, found[name], paper, strict=True)
            },
        }
    logs = np.array([[np.log(v) for v in rows[name]["ratio"].values()] for name in FEEDBACK])
    deviations = [abs(v - 1.0) for name in FEEDBACK for v in rows[name]["ratio"].values()]
    return {
        **rows,
        "rms_log_error": float(np.sqrt(np.mean(logs**2))),
        "worst_deviation": max(deviations),
        "within_5_percent": sum(d <= NEAR for d in deviations),
        "orders_kept": _orders(found),
        "source": sorted({runs[f"table1_{name}"].source for name in FEEDBACK}),
    }


def _orders(found: Mapping[str, Indices]) -> dict[str, bool]:
    """For each index, whether the controllers come in the paper's order."""
    kept = {}
    for i, index in enumerate(Indices._fields):
        ours = sorted(FEEDBACK, key=lambda name: found[name][i])
        paper = sorted(FEEDBACK, key=lambda name: PAPER_TABLE_1[name][i])
        kept[index] = ours == paper
    return kept


def rows_of(table: Mapping[str, Any]) -> list[list[str]]:
    """Table 1 in words: ours, the paper's, and the ratio."""
    rows = []
    for name in FEEDBACK:
        row = table[name]
        rows.append([name.upper(), *(f"{v:.3f}" for v in row["indices"].values())])
        rows.append(["paper", *(f"{v:.3f}" for v in row["paper"].values())])
        rows.append(["ratio", *(f"{v:.3f}" for v in row["ratio"].values())])
    return rows


def verdicts(table: Mapping[str, Any]) -> list[str]:
    """Sentences on what of the paper is reproduced and what is not."""
    count = sum(len(table[name]["ratio"]) for name in FEEDBACK)
    texts = [
        f"rms log error {table['rms_log_error']:.4f}; {table['within_5_percent']} of {count} numbers within "
        f"{100 * NEAR:.0f} %, worst {100 * table['worst_deviation']:.1f} % off"
    ]
    for name in FEEDBACK:
        for index, ratio in table[name]["ratio"].items():
            if abs(ratio - 1.0) > NEAR:
                texts.append(f"{name.upper()} {index} is {100.0 * (ratio - 1.0):+.1f} % off the paper's")
    wrong = [index for index, kept in table["orders_kept"].items() if not kept]
    texts.append(
        "the controllers come in the paper's order in "
        + ("every index" if not wrong else f"every index but {', '.join(wrong)}")
    )
    return texts


def write(
    folder: Path, table: Mapping[str, Any], figures: Sequence[Figure], extra: Mapping[str, str]
) -> list[Path]:
    """Write table1.json, each figure as PNG and SVG, and index.html; ``extra``: further sections of HTML.

    Raises OSError.
    """
    written = [folder / "table1.json"]
    outputs.write(str(written[0]), outputs.as_json(table))
    head = ["", *(index if index == "c_u" else f"{index} [V]" for index in Indices._fields)]
    sections = {"Table 1": page.table(head, rows_of(table)) + page.notes(verdicts(table), "text")}
    for figure in figures:
        paths = [folder / f"{figure.name}.png", folder / f"{figure.name}.svg"]
        draw_columns(paths, {"": figure.plots}, figure.x_title, figure.title, figure.logarithmic_x)
        written += paths
        links = " ".join(f'<a href="{path.name}">{path.suffix[1:].upper()}</a>' for path in paths)
        sections[figure.title] = (
            page.figure(figure.plots, figure.x_title, figure.logarithmic_x)
            + f"<p>{links}</p>"
            + page.notes(figure.notes)
        )
    sections |= extra
    index = folder / "index.html"
    outputs.write(str(index), page.page("The paper, reproduced", sections))
    return [*written, index]


def paragraph(text: str) -> str:
    """A paragraph of HTML."""
    return f"<p>{html.escape(text)}</p>"
