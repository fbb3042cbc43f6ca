# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `calibrate`: finds a simulated valve that gives a measured table of indices."""

import argparse
import math
import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from valve_control import interrupts, outputs
from valve_control.cli.common import (
    MOST_SEED,
    Progress,
    check_outputs,
    check_processes,
    say,
    write_json,
    wrote,
)
from valve_control.cli.simulate import settings_of, setup_options
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, Values, defaults

if TYPE_CHECKING:
    from valve_control.design.calibration.search import Problem
    from valve_control.design.calibration.space import Dimension, Settings

FIELDS = ("e_M", "e_F", "e_rms", "u_rms", "c_u")
MOST = 10**9  # valves to try
CLEAR = 1.5  # times the best cost, within which a quantity counts as not excluded


def add_commands(commands: Any) -> None:
    """Add calibrate to the command's sub-commands."""
    calibrate = commands.add_parser(
        "calibrate",
        parents=[setup_options()],
        help="find the simulated valve on which the controllers reproduce a table of indices",
        description="Search the simulated valve (friction, gain, LVDT and other unknown quantities) on "
        "which the controllers reproduce a measured table: CSV, YAML or JSON with a row for each "
        "controller and the columns "
        f"{', '.join(FIELDS)}. 'paper' is Table 1 of the paper.",
    )
    calibrate.add_argument("table", metavar="TABLE", help="file with the measured indices, or: paper")
    group = calibrate.add_argument_group("search")
    group.add_argument("--search-seed", type=int, default=1, metavar="N", help="seed of the search (1)")
    group.add_argument(
        "--evaluations", type=int, default=40000, metavar="N", help="number of valves to simulate (40000)"
    )
    group.add_argument(
        "--population",
        type=int,
        default=40,
        metavar="N",
        help="population of the first CMA-ES; each restart doubles it (40)",
    )
    group.add_argument(
        "--noise-seeds",
        type=int,
        default=4,
        metavar="N",
        help="fit the mean over N noise seeds, from --seed on, and the first seed alone (4)",
    )
    group.add_argument(
        "--fix",
        action="append",
        default=[],
        metavar="NAME",
        help="quantity that stays constant; again for more",
    )
    group.add_argument(
        "--from-present",
        action="store_true",
        help="begin at the given parameters instead of random points of the ranges",
    )
    group.add_argument(
        "--step", type=float, default=0.25, metavar="X", help="first step as share of the ranges (0.25)"
    )
    group.add_argument(
        "--processes",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="number of processes (all cores)",
    )
    output = calibrate.add_argument_group("output")
    output.add_argument(
        "--output", metavar="FILE", help="ROS 2 parameter file of valve, command and controllers"
    )
    output.add_argument("--json", metavar="FILE", help="all results as JSON; - for standard output alone")
    output.add_argument(
        "--profile",
        type=int,
        default=0,
        metavar="N",
        help="report the identifiability of each quantity and the contribution of each effect, with N "
        "evaluations per point (0: no report)",
    )
    output.add_argument(
        "--trials", action="store_true", help="simulate the result with other noise, motions and drifts"
    )
    calibrate.add_argument("--ranges", action="store_true", help="list the free quantities and exit")
    calibrate.set_defaults(run=_calibrate)


def _calibrate(arguments: argparse.Namespace) -> int:
    from valve_control.control.parameters import build
    from valve_control.design.calibration import measured, objective, search, space

    check_outputs(arguments, [arguments.output])
    table = measured.read(arguments.table)
    base = settings_of(arguments)
    build.commands(base["command_source"])  # a file that cannot be read is found out before the search
    dimensions = _chosen(arguments, base, table)
    if arguments.ranges:
        for d in dimensions:
            say(arguments, f"{d.name:28}{d.low:10g} … {d.high:<10g}{d.unit:8}{d.reason}")
        listed = [{"name": d.name, "low": d.low, "high": d.high, "unit": d.unit} for d in dimensions]
        write_json(arguments, {"ranges": listed})
        return 0
    _check_counts(arguments)
    first = int(str(base["valve_simulator"]["seed"]))
    problem = search.Problem(base, table, dimensions, range(first, first + arguments.noise_seeds))
    start = _present(base, dimensions) if arguments.from_present else None
    progress = Progress(arguments.evaluations, "valves")
    found = search.search(
        problem=problem,
        seed=arguments.search_seed,
        evaluations=arguments.evaluations,
        population=arguments.population,
        processes=arguments.processes,
        told=lambda done, best: progress(done, f", best cost {best:.4f}"),
        start=start,
        step=arguments.step,
    )
    stopped = found.evaluations < arguments.evaluations
    if stopped:
        print(
            f"stopped after {found.evaluations} of {arguments.evaluations} valves; this is the best of them",
            file=sys.stderr,
        )
    values = space.values_at(dimensions, found.point)
    settings = space.changed(base, dimensions, values)
    runs = objective.run(settings, list(table), problem.seeds)
    alone = {name: rows[:1] for name, rows in runs.items()}
    result: dict[str, Any] = {
        "table": {name: row._asdict() for name, row in table.items()},
        "mean": _nearness(runs, table),
        "first_seed": _nearness(alone, table),
        "values": values,
        "evaluations": found.evaluations,
        "seconds": found.seconds,
        "search_seed": arguments.search_seed,
        "noise_seeds": list(problem.seeds),
    }
    if arguments.json != "-":
        _print_fit(result, dimensions)
    if arguments.output is not None:
        save(arguments.output, arguments.table, base, settings, result)
        wrote(arguments, arguments.output)
    if arguments.trials and not stopped:
        result["trials"] = _trials(arguments, settings, table)
    if arguments.profile and not stopped:
        result["identifiability"] = _identifiability(arguments, problem, found.point)
    write_json(arguments, result)
    return interrupts.STATUS if stopped else 0


def _chosen(arguments: argparse.Namespace, base: "Settings", table: Mapping[str, Any]) -> list["Dimension"]:
    """Quantities that the search may vary."""
    from valve_control.design.calibration.space import DIMENSIONS

    names = [d.name for d in DIMENSIONS]
    for name in arguments.fix:
        if name not in names:
            raise ParameterError(f"--fix {name}: there is no such quantity; there are {', '.join(names)}")
    chosen = [d for d in DIMENSIONS if d.name not in arguments.fix and _matters(d, base, table)]
    if not chosen:
        raise ParameterError("every quantity is fixed; leave out some --fix")
    return chosen


def _matters(dimension: "Dimension", base: "Settings", table: Mapping[str, Any]) -> bool:
    """Whether a controller of the table, or the command's shape, depends on the quantity."""
    target = dimension.targets[0]
    if target.node == "controller":
        return any(t.parameter.split(".")[0] in table for t in dimension.targets)
    scenario = base["command_source"]["scenario"]
    if target.node == "command_source" and scenario != "point_to_point":
        return scenario != "array" and target.parameter in ("amplitude", "offset")
    return True


def _present(base: "Settings", dimensions: Sequence["Dimension"]) -> Any:
    """The given parameters as a point of the unit cube; prints which of them lie outside of their range."""
    import numpy as np

    from valve_control.design.calibration.space import present

    for d in dimensions:
        value = present(base, d)
        if not d.low <= value <= d.high:
            near = min(max(value, d.low), d.high)
            print(f"{d.name} is {value:g}, outside of its range; begins at {near:g}", file=sys.stderr)
    return np.array([d.to_unit(present(base, d)) for d in dimensions])


def _check_counts(arguments: argparse.Namespace) -> None:
    check_processes("processes", arguments.processes)
    if not 0.001 <= arguments.step <= 1.0:
        raise ParameterError(f"--step is {arguments.step:g}; it must lie between 0.001 and 1")
    ranges = {
        "evaluations": (1, MOST),
        "population": (4, 10_000),
        "noise_seeds": (1, 1000),
        "profile": (0, MOST),
        "search_seed": (0, MOST_SEED),
    }
    for name, (low, high) in ranges.items():
        if not low <= getattr(arguments, name) <= high:
            option = name.replace("_", "-")
            raise ParameterError(
                f"--{option} is {getattr(arguments, name)}; it must lie between {low} and {high}"
            )


def _nearness(runs: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Fit, ratios to the table and pairs in another order, for JSON."""
    import numpy as np

    from valve_control.design.calibration import objective

    return {
        **objective.fit(runs, table)._asdict(),
        "ratios": {
            name: {field: float(np.exp(value)) for field, value in zip(FIELDS, row, strict=True)}
            for name, row in objective.log_ratios(runs, table).items()
        },
        "swapped": [list(pair) for pair in objective.swapped(runs, table)],
    }


def _off(log_ratio: float) -> str:
    """Log ratio as text in per cent."""
    return f"{100.0 * math.expm1(log_ratio):.1f} %"


def _print_fit(result: Mapping[str, Any], dimensions: Sequence["Dimension"]) -> None:
    seeds = result["noise_seeds"]
    cases = {f"mean of {len(seeds)} seeds": "mean", f"seed {seeds[0]} alone": "first_seed"}
    for title, key in list(cases.items())[: len(seeds)]:
        fit = result[key]
        print(f"\n{title + ':':20}" + "".join(f"{field:>9}" for field in FIELDS) + "   index / table")
        for name, row in fit["ratios"].items():
            print(f"{name:20}" + "".join(f"{value:9.3f}" for value in row.values()))
        orders = ", ".join(f"{index}: {better} not below {worse}" for index, better, worse in fit["swapped"])
        print(f"rms log error {fit['rms']:.4f}, worst {_off(fit['worst'])}, ", end="")
        print(f"orders that differ: {orders or 'none'}")
    print(f"\n{result['evaluations']} valves in {result['seconds']:.0f} s\n")
    for d in dimensions:
        value = result["values"][d.name]
        edge = min(d.to_unit(value), 1.0 - d.to_unit(value)) < 0.005
        print(f"{d.name:28}{value:12.5g} {d.unit:8}" + (" at the end of its range" if edge else ""))


def save(path: str, table: str, base: "Settings", settings: "Settings", result: Mapping[str, Any]) -> None:
    """Write what differs from the defaults as a ROS 2 parameter file. Raises OSError."""
    from valve_control.control.parameters import files

    fits = " and ".join(
        f"{100 * result[key]['rms']:.1f} % rms ({what})"
        for key, what in (
            ("mean", f"mean of noise seeds {result['noise_seeds']}"),
            ("first_seed", "the first"),
        )
    )
    comments = [
        f"Calibrated to the table '{table}': log error {fits}.",
        f"valve-control calibrate, search seed {result['search_seed']}, {result['evaluations']} valves.",
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
    outputs.write(path, files.as_yaml(sections, comments))


def _trials(
    arguments: argparse.Namespace, settings: "Settings", table: Mapping[str, Any]
) -> list[dict[str, Any]]:
    from valve_control.design.calibration.trials import trials

    found = trials(settings, list(table))
    if arguments.json != "-":
        print(f"\n{'trial':32}{'controller':12}" + "".join(f"{field:>9}" for field in FIELDS))
        for trial in found:
            for name, row in trial.found.items():
                print(f"{trial.name:32}{name:12}" + "".join(f"{value:9.4f}" for value in row))
    return [{"name": t.name, "indices": {n: r._asdict() for n, r in t.found.items()}} for t in found]


def _identifiability(arguments: argparse.Namespace, problem: "Problem", point: Any) -> dict[str, Any]:
    from tqdm import tqdm

    from valve_control.design.calibration import identifiability as ident
    from valve_control.design.calibration.search import cost_at

    count = 2 * len(problem.dimensions)
    with tqdm(total=count, desc="profiles", file=sys.stderr) as bar:

        def done() -> None:
            bar.update(1)

        profiles = ident.profiles(problem, point, arguments.profile, arguments.processes, done)
        absences = ident.absences(problem, point, arguments.profile, arguments.processes, done)
    limit = CLEAR * cost_at(problem, point)
    if arguments.json != "-":
        print(f"\nhow identifiable: interval in which the cost stays below {CLEAR:g} times the best")
        for d, profile in zip(problem.dimensions, profiles, strict=True):
            low, high = profile.interval(limit)
            share = d.to_unit(high) - d.to_unit(low)
            print(f"{d.name:28}{low:12.4g} … {high:<12.4g}{d.unit:8}{100.0 * share:5.0f} % of the range")
        print("\nwithout one effect, everything else chosen anew: rms log error, worst number")
        for absence in sorted(absences, key=lambda a: -a.fit.rms):
            print(f"{absence.name:28}{absence.fit.rms:8.4f}{_off(absence.fit.worst):>10}")
    return {
        "limit": limit,
        "profiles": [{**p._asdict(), "interval": p.interval(limit)} for p in profiles],
        "without": {a.name: a.fit._asdict() for a in absences},
    }
