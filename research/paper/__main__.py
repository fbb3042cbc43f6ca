# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.paper``: makes the paper's Table 1 and figures again."""

import argparse
import importlib.util
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from research import running
from valve_control.cli.common import Parser, say
from valve_control.parameter import ParameterError, number

if TYPE_CHECKING:
    from research.paper.traces import Trace


def _options() -> Parser:
    paper = running.options(
        "paper",
        "Run PID, ARC, OARC and the compensators on the calibrated valve, through the real nodes "
        "in lockstep, and write table1.json, the paper's figures as PNG and SVG, and index.html.",
        numbers=False,
    )
    paper.add_argument("--out", default="out/paper", metavar="FOLDER", help="output folder (out/paper)")
    paper.add_argument(
        "--offline",
        action="store_true",
        help="simulate without ROS nodes; the numbers are the same, bit for bit",
    )
    paper.add_argument("--config", metavar="FILE", help="another calibrated valve (d3fxe_experiment.yaml)")
    paper.set_defaults(json=None)
    return paper


def _paper(arguments: argparse.Namespace) -> int:
    from research.paper import report
    from research.paper.figures import figures
    from research.paper.runs import CONFIG, paper_runs, valve_gain, valve_of
    from valve_control.control.parameters import ros_file

    config = arguments.config or str(ros_file.config_folder() / CONFIG)
    valve = valve_of(config)
    planned = paper_runs(valve)
    folder = Path(arguments.out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"output folder {folder} cannot be made: {error.strerror}") from error
    runs = _offline(planned, config) if arguments.offline else _through_nodes(planned, folder, config)
    if runs is None:
        return 1
    table = report.table_1(runs)
    print(f"\n{'':8}" + "".join(f"{name:>9}" for name in ("e_M", "e_F", "e_rms", "u_rms", "c_u")))
    for row in report.rows_of(table):
        print(f"{row[0]:8}" + "".join(f"{cell:>9}" for cell in row[1:]))
    for text in report.verdicts(table):
        print(text)
    made = figures(runs, valve_gain(valve), number(valve, "u_max"))
    for figure in made:
        for note in figure.notes:
            print(f"{figure.title.split(':')[0]}: {note}")
    source = (
        "These figures draw the messages of the real nodes: controller, valve simulator and command source "
        "as processes over DDS, in lockstep."
        if not arguments.offline
        else "These figures were simulated offline, without nodes."
    )
    filled = sum(run.filled for run in runs.values())
    heard = f" Messages not heard by the tool and taken from the equal run offline: {filled}."
    written = report.write(
        folder, table, made, {"How": report.paragraph(source + ("" if arguments.offline else heard))}
    )
    for path in written:
        say(arguments, f"wrote {path}")
    return 0


def _offline(planned: list[Any], config: str) -> "dict[str, Trace]":
    from research.paper import traces
    from research.paper.runs import values_of
    from valve_control.control.parameters import build, files
    from valve_control.control.simulation import offline

    set_by_file = files.load(config)
    runs = {}
    for run in planned:
        values = values_of(run, set_by_file)
        command = build.commands(values["command_source"])
        runs[run.name] = traces.offline(
            offline.simulate(values["controller"], values["valve_simulator"], command)
        )
    return runs


def _through_nodes(planned: list[Any], folder: Path, config: str) -> "dict[str, Trace] | None":
    """Runs of the real nodes, started by another process, as this one imports no ROS; None if they fail."""
    from research.paper import traces

    if importlib.util.find_spec("rclpy") is None:
        raise ParameterError("paper needs ROS 2 (rclpy) for the runs of the nodes; or give --offline")
    logs = folder / "runs"
    logs.mkdir(exist_ok=True)
    command = [
        sys.executable,
        "-m",
        "research.campaigns.paper",
        "--out",
        str(logs),
        "--config",
        config,
    ]
    status = subprocess.run(command, check=False).returncode
    if status != 0:
        print(f"the runs of the nodes failed; their logs are in {logs}", file=sys.stderr)
        return None
    results = json.loads((logs / "lockstep.json").read_text(encoding="utf-8"))
    print(f"{len(results)} runs through the nodes, each equal to its twin offline, bit for bit")
    return {run.name: traces.load(logs / f"{run.name}.npz") for run in planned}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns the exit status."""
    return running.run(_options(), _paper, argv)


if __name__ == "__main__":
    sys.exit(main())
