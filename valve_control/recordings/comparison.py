"""Several bags side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from valve_control.analysis.figures import COLOURS, Line, Plot, Trace, draw_traces
from valve_control.analysis.indices import Indices
from valve_control.analysis.page import figure, notes, page
from valve_control.recordings.recording import Aligned
from valve_control.recordings.report import index_table
from valve_control.recordings.study import NONE, Study


class BagRun(NamedTuple):
    """One valve of one bag."""

    name: str  # bag and valve
    controller: str
    indices: Indices
    signals: Aligned | None
    left_out: list[str]


def runs(path: str, study: Study) -> list[BagRun]:
    """The valves of a bag."""
    bag = Path(path).stem if Path(path).is_file() else Path(path).resolve().name
    many = len(study.valves) > 1
    return [
        BagRun(
            f"{bag}/{name}" if many else bag,
            valve.controller,
            valve.parts[0].indices if valve.parts else NONE,
            valve.signals,
            [f"{bag}: {text}" for text in (*study.left_out, *valve.left_out)],
        )
        for name, valve in study.valves.items()
    ]


def labels(names: Sequence[str]) -> list[str]:
    """``names``, numbered where two are the same."""
    return [
        f"{name} ({names[: i + 1].count(name)})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def as_dict(name: str, run: BagRun) -> dict[str, Any]:
    """One run for JSON."""
    return {
        "name": name,
        "controller": run.controller or None,
        "indices": run.indices._asdict(),
        "left_out": run.left_out,
    }


def draw(path: Path, names: Sequence[str], runs: Sequence[BagRun]) -> None:
    """Overlaid traces as PNG. Raises OSError."""
    traces = {
        name: Trace(run.signals.time, run.signals.command, run.signals.measurement, run.signals.voltage)
        for name, run in zip(names, runs, strict=True)
        if run.signals is not None
    }
    draw_traces(path, {"recorded": traces}, "valve_control: bags")


def html(names: Sequence[str], runs: Sequence[BagRun]) -> str:
    """Table and overlaid figures as a page."""
    rows = [(name, run.controller, run.indices, "") for name, run in zip(names, runs, strict=True)]
    positions, errors, voltages = [], [], []
    for i, (name, run) in enumerate(zip(names, runs, strict=True)):
        if run.signals is None:
            continue
        s, colour = run.signals, COLOURS[i % len(COLOURS)]
        positions.append(Line(f"{name}: command", s.time, s.command, colour, True))
        positions.append(Line(name, s.time, s.measurement, colour))
        errors.append(Line(name, s.time, s.measurement - s.command, colour))
        voltages.append(Line(name, s.time, s.voltage, colour))
    plots = [Plot("spool position [V]", positions), Plot("error [V]", errors), Plot("voltage [V]", voltages)]
    left_out = notes([text for run in runs for text in run.left_out])
    return page(
        "valve_control: bags compared",
        {
            "Indices": index_table(rows) + left_out,
            "Signals, each from its first command on": figure(plots, "time [s]"),
        },
    )
