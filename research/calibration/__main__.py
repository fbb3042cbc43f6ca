# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.calibration``: config/d3fxe_experiment.yaml, fitted to the paper's Table 1."""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from research import running
from research.calibration import objective, search
from research.calibration.space import DIMENSIONS, Settings, changed, values_at
from research.paper import PAPER_TABLE_1
from valve_control import interrupts, outputs
from valve_control.cli.common import (
    CORES,
    MOST_SEED,
    MOST_THREADS,
    check_outputs,
    numbers,
    progress,
    within,
    write_json,
    wrote,
)
from valve_control.control.analysis.indices import Indices
from valve_control.control.parameters import ros_file
from valve_control.control.parameters.table import NODES
from valve_control.parameter import Values, defaults, updated

EVALUATIONS = 40_000
POPULATION = 40  # of the first CMA-ES
NOISE_SEEDS = (1, 2, 3, 4)
FIG_5 = {"duration": 9.3, "start": 0.0}  # s  of the command
MOST = 10**9  # valves to try


def paper_settings() -> Settings:
    """Parameters by node before the fit, with the command of the paper's Fig. 5."""
    base = {node: defaults(table) for node, table in NODES.items()}
    base["command_source"] = updated(NODES["command_source"], base["command_source"], FIG_5)
    return base


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = running.options(
        "calibration",
        "Search the simulated valve (friction, gain, LVDT and other quantities that the paper does not "
        "print) on which PID, ARC and OARC give the paper's Table 1.",
    )
    numbers(
        parser,
        ("search-seed", within(0, MOST_SEED), 1, "N", "seed of the search (%(default)s)"),
        ("evaluations", within(1, MOST), EVALUATIONS, "N", "valves to simulate (%(default)s)"),
        ("processes", within(1, MOST_THREADS), CORES, "N", "processes (all cores)"),
    )
    parser.add_argument(
        "--output", metavar="FILE", help="ROS 2 parameter file of valve, command and controllers"
    )
    return running.run(parser, _calibrate, argv)


def _calibrate(arguments: argparse.Namespace) -> int:
    check_outputs(arguments)
    base = paper_settings()
    problem = search.Problem(base, PAPER_TABLE_1, DIMENSIONS, NOISE_SEEDS)
    with progress(arguments.evaluations, "valves") as bar:

        def show(done: int, best: float) -> None:
            bar.set_postfix_str(f"best cost {best:.4f}", refresh=False)
            bar.update(done - bar.n)

        count, processes = arguments.evaluations, arguments.processes
        found = search.search(problem, arguments.search_seed, count, POPULATION, processes, show)
    stopped = found.evaluations < arguments.evaluations
    if stopped:
        print(
            f"stopped after {found.evaluations} of {arguments.evaluations} valves; this is the best of them",
            file=sys.stderr,
        )
    values = values_at(DIMENSIONS, found.point)
    settings = changed(base, DIMENSIONS, values)
    runs = objective.run(settings, list(PAPER_TABLE_1), NOISE_SEEDS)
    result: dict[str, Any] = {
        "mean": _nearness(runs),
        "first_seed": _nearness({name: rows[:1] for name, rows in runs.items()}),
        "values": values,
        "evaluations": found.evaluations,
        "seconds": found.seconds,
        "search_seed": arguments.search_seed,
        "noise_seeds": list(NOISE_SEEDS),
    }
    if arguments.json != "-":
        _print_fit(result)
    if arguments.output is not None:
        _save(arguments.output, base, settings, result)
        wrote(arguments, arguments.output)
    write_json(arguments, result)
    return interrupts.STATUS if stopped else 0


def _nearness(runs: Mapping[str, list[Indices]]) -> dict[str, Any]:
    """Fit, ratios to the table and pairs in another order, for JSON."""
    return {
        **objective.fit(runs, PAPER_TABLE_1)._asdict(),
        "ratios": {
            name: dict(zip(Indices._fields, np.exp(row).tolist(), strict=True))
            for name, row in objective.log_ratios(runs, PAPER_TABLE_1).items()
        },
        "swapped": [list(pair) for pair in objective.swapped(runs, PAPER_TABLE_1)],
    }


def _print_fit(result: Mapping[str, Any]) -> None:
    seeds = result["noise_seeds"]
    for title, key in ((f"mean of {len(seeds)} seeds", "mean"), (f"seed {seeds[0]} alone", "first_seed")):
        fit = result[key]
        print(f"\n{title + ':':20}" + "".join(f"{name:>9}" for name in Indices._fields) + "   index / table")
        for name, row in fit["ratios"].items():
            print(f"{name:20}" + "".join(f"{value:9.3f}" for value in row.values()))
        orders = ", ".join(f"{index}: {better} not below {worse}" for index, better, worse in fit["swapped"])
        worst = f"{100.0 * math.expm1(fit['worst']):.1f} %"
        print(f"rms log error {fit['rms']:.4f}, worst {worst}, orders that differ: {orders or 'none'}")
    print(f"\n{result['evaluations']} valves in {result['seconds']:.0f} s\n")
    for d in DIMENSIONS:
        value = result["values"][d.name]
        edge = min(d.to_unit(value), 1.0 - d.to_unit(value)) < 0.005
        print(f"{d.name:28}{value:12.5g} {d.unit:8}" + (" at the end of its range" if edge else ""))


def _save(path: str, base: Settings, settings: Settings, result: Mapping[str, Any]) -> None:
    """Write the parameters that differ from the defaults as a ROS 2 parameter file. Raises OSError."""
    fits = [f"{100 * result[key]['rms']:.1f} % rms" for key in ("mean", "first_seed")]
    comments = [
        f"Calibrated to the table 'paper': log error {fits[0]} (mean of noise seeds "
        f"{result['noise_seeds']}) and {fits[1]} (the first).",
        f"python -m research.calibration, search seed {result['search_seed']}, "
        f"{result['evaluations']} valves.",
    ]
    sections: dict[str, Values] = {}
    for node, values in settings.items():
        standard = defaults(NODES[node])
        differing = {
            name: value
            for name, value in values.items()
            if value != standard[name] or value != base[node][name]
        }
        if differing:
            sections[f"/**/{node}"] = differing
    outputs.write(path, ros_file.as_yaml(sections, comments))


if __name__ == "__main__":
    sys.exit(main())
