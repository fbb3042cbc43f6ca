# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-commands for bags: analyze, replay, compare of bags, and bag recover."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control import outputs
from valve_control.cli.common import (
    Parser,
    bag_options,
    check_outputs,
    deliver,
    output_group,
    parameter_options,
    repeated,
    say,
    tell_notes,
    write_json,
)
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError
from valve_control.recordings.bags.errors import BagError

if TYPE_CHECKING:
    from valve_control.recordings.analysis import ValveAnalysis
    from valve_control.recordings.recording import Recording
    from valve_control.recordings.report import Report


def _bag_options() -> Parser:
    options = Parser(add_help=False)
    options.add_argument(
        "bag",
        metavar="BAG",
        help="folder with metadata.yaml, an .mcap or .db3 file, or a log: .csv, .lvm, .mat or .mf4",
    )
    bag_options(
        options.add_argument_group("input"),
        "source of spool_command, spool_position or valve_voltage: any number of any message, such "
        "as spool_position=/joint_states.position[0]*250 (volts per unit after *, with an "
        "offset *1.25-15; or one of the words @%%, @0..10V, @4..20mA); boom/spool_position=... for a valve "
        "named boom; of a table: spool_position=COLUMN*1.25-15, time=COLUMN*0.001 in seconds or "
        "time=row*0.001 at 1 kHz",
        of=False,
    )
    output_group(
        options,
        csv="aligned signals as CSV (of several valves: one file each)",
        html="one self-contained page with zoomable figures",
    )
    return options


def add_commands(commands: Any) -> None:
    """Add analyze, replay and bag to the command's sub-commands."""
    shared = _bag_options()
    analyze = commands.add_parser(
        "analyze",
        parents=[shared],
        help="analyse a bag: sample rates, indices, estimates, spectra",
        description="Analyse a rosbag2 recording without ROS. Exit status 1 if an expectation is not met.",
    )
    repeated(
        analyze, "--expect", "CONDITION", "condition that the results must meet, such as 'e_rms<0.02', "
        "'boom.latency_s.p99<0.001', 'timing.spool_position.lost==0'",
    )  # fmt: skip
    analyze.set_defaults(run=_analyze)
    _add_replay(commands, shared)
    bag = commands.add_parser("bag", help="finish a bag", description="Finish a bag.")
    tasks = bag.add_subparsers(dest="bag_task", required=True, metavar="TASK")
    recover = tasks.add_parser(
        "recover",
        help="write a finished copy of an unfinished or damaged bag",
        description="Copy all that can be read of a bag, such as that of a killed recorder, into a new, "
        "finished bag. The bag itself stays as it is.",
    )
    recover.add_argument("bag", metavar="BAG", help="folder of the bag, or one file")
    recover.add_argument("--out", metavar="FOLDER", help="new bag (default: BAG_recovered)")
    recover.add_argument("--json", metavar="FILE", help="report as JSON; - for standard output alone")
    recover.set_defaults(run=_recover)


def _add_replay(commands: Any, shared: argparse.ArgumentParser) -> None:
    replay = commands.add_parser(
        "replay",
        parents=[shared],
        help="replay a bag: in shadow or as what-if",
        description="shadow: a controller receives the recorded command and LVDT readings; its voltage "
        "is compared with the recorded one. what-if: the closed loop is simulated from the recorded "
        "command.",
    )
    replay.add_argument(
        "--mode",
        choices=("shadow", "what-if"),
        default="shadow",
        help="mode of the replay (default: shadow)",
    )
    replay.add_argument("--of", metavar="VALVE", help="valve to replay, if the bag has several")
    group = replay.add_argument_group("shadow and what-if: instead of the recorded parameters")
    group.add_argument("--controller", choices=LAWS, help="control law")
    parameter_options(group, "a parameter")
    replay.set_defaults(run=_replay)


# Reading


def _load(arguments: argparse.Namespace, path: str, journals: bool = False) -> "Recording":
    from valve_control.recordings import mapping, recording

    start, end = getattr(arguments, "start", None), getattr(arguments, "end", None)
    if start is not None and end is not None and end <= start:
        raise ParameterError(f"--to {end:g} lies not after --from {start:g}")
    maps = mapping.maps_of(path, arguments.map, getattr(arguments, "bags", [path]))
    return recording.load(path, maps, start, end, journals, arguments.clock)


# Tasks


def _analyze(arguments: argparse.Namespace) -> int:
    from valve_control.recordings import analysis_report, axis_analysis, expectations
    from valve_control.recordings.analysis import analyze

    check_outputs(arguments, [arguments.csv, arguments.html])
    loaded = _load(arguments, arguments.bag)
    result = analyze(loaded)
    ends = (arguments.start, arguments.end)
    part = (None if at is None else loaded.bag.begin + round(at * 1e9) for at in ends)
    report = analysis_report.of_bag(result, axis_analysis.axes(loaded.bag, *part))
    outcomes = [o for text in arguments.expect for o in expectations.check(text, report.about["valves"])]
    report.about["expectations"] = [outcome._asdict() for outcome in outcomes]
    csv_files = _csv_files(arguments.csv, result.valves)
    check_outputs(arguments, [*csv_files, arguments.html])
    _deliver(arguments, report, csv_files)
    for outcome in outcomes:
        value = "missing" if outcome.value is None else f"{outcome.value:.6g}"
        say(arguments, f"{'met' if outcome.met else 'NOT MET'}: {outcome.text} ({outcome.valve}: {value})")
    return 0 if all(outcome.met for outcome in outcomes) else 1


def _csv_files(path: str | None, valves: "dict[str, ValveAnalysis]") -> dict[str, str]:
    """Texts by path: one file, or one for each of several valves."""
    from valve_control.recordings.analysis_report import csv_text

    if path is None:
        return {}
    usable = {name: valve.signals for name, valve in valves.items() if valve.signals is not None}
    if not usable:
        raise BagError("there is nothing for --csv: no valve has readings that can be aligned")
    if len(usable) == 1:
        return {path: csv_text(*usable.values())}
    stem, ending = Path(path).with_suffix(""), Path(path).suffix
    return {f"{stem}_{name.replace('/', '_')}{ending}": csv_text(s) for name, s in usable.items()}


def _replay(arguments: argparse.Namespace) -> int:
    from valve_control.recordings.analysis import analyze
    from valve_control.recordings.recording import chosen

    check_outputs(arguments, [arguments.csv, arguments.html])
    loaded = _load(arguments, arguments.bag, journals=arguments.mode == "shadow")
    valve = chosen(arguments.bag, analyze(loaded).valves, arguments.of)
    valve = valve._replace(left_out=[*loaded.problems, *valve.left_out])
    report = (_replay_shadow if arguments.mode == "shadow" else _replay_what_if)(arguments, valve)
    csv_files = {} if arguments.csv is None else {arguments.csv: outputs.csv_text(report.columns, "%.17g")}
    _deliver(arguments, report, csv_files)
    return 0


def _overrides(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    from valve_control.control.parameters import files

    direct = {"controller": {"controller": arguments.controller}}
    notes: list[str] = []
    changes = files.given(arguments.params_file, direct, arguments.set, notes, recorded=True)
    tell_notes(notes)
    return changes


def _replay_shadow(arguments: argparse.Namespace, analysis: "ValveAnalysis") -> "Report":
    from tqdm import tqdm

    from valve_control.recordings import replay_report, shadow

    valve = analysis.valve
    changes = _overrides(arguments)
    names = [n for node, own in changes.items() for n in own if n not in changes["controller"]]
    if names:
        raise ParameterError(f"replay --mode shadow has no {names[0]}, which is not of the controller")
    count = len(valve.signals["spool_position"].time) if "spool_position" in valve.signals else 0
    with tqdm(total=count, desc="shadow", unit=" samples", disable=count < 20_000, ascii=True) as progress:
        result = shadow.replay(valve, changes["controller"], progress.update)
    result = result._replace(left_out=[*analysis.left_out, *result.left_out])
    return replay_report.of_shadow(result, arguments.bag, valve.name)


def _replay_what_if(arguments: argparse.Namespace, analysis: "ValveAnalysis") -> "Report":
    from valve_control.control.parameters import files
    from valve_control.recordings import replay_report, what_if

    if analysis.signals is None:
        raise BagError("; ".join(analysis.left_out))
    changes = _overrides(arguments)
    simulated = {node: NODES[node] for node in ("controller", "valve_simulator")}
    files.refuse_others(arguments.set, simulated, "replay --mode what-if simulates the recorded command")
    result = what_if.replay(
        analysis.valve, analysis.signals, changes["controller"], changes["valve_simulator"]
    )
    result = result._replace(left_out=[*analysis.left_out, *result.left_out])
    if result.run.warning:
        print(f"warning: {result.run.warning}", file=sys.stderr)
    return replay_report.of_what_if(result, arguments.bag, analysis.valve.name)


def _deliver(arguments: argparse.Namespace, report: "Report", csv_files: Mapping[str, str]) -> None:
    """Print a report, and write it as HTML and JSON where asked for, and the ``csv_files``: texts by path."""
    if arguments.json != "-":
        print(report.text)
    for path, content in csv_files.items():
        deliver(arguments, path, content)
    if arguments.html is not None:
        deliver(arguments, arguments.html, report.html)
    write_json(arguments, report.about)


def compare_bags(arguments: argparse.Namespace) -> None:
    """Report the indices and overlaid runs of several bags."""
    from valve_control.recordings import comparison
    from valve_control.recordings.analysis import analyze

    check_outputs(arguments, [arguments.html])
    runs = []
    for path in arguments.bags:
        runs += comparison.runs(path, analyze(_load(arguments, path)))
    _deliver(arguments, comparison.report(runs), {})


def _recover(arguments: argparse.Namespace) -> int:
    from valve_control.recordings.bags.recover import recover

    check_outputs(arguments)
    result = recover(Path(arguments.bag), Path(arguments.out) if arguments.out is not None else None)
    out = str(result.out) if result.out is not None else None
    write_json(arguments, {**result._asdict(), "bag": str(result.bag), "out": out})
    if result.messages == 0:
        say(arguments, f"{result.bag} holds no message that can be read; nothing was written")
        return 1
    if result.out is None:
        say(arguments, f"{result.bag} is whole ({result.messages} messages), nothing was written")
        return 0
    for problem in result.problems:
        say(arguments, f"note: {problem}")
    chunks = f", {result.damaged_chunks} damaged chunks left out" if result.damaged_chunks else ""
    lost = "" if result.lost is None else f", {result.lost} lost"
    say(arguments, f"wrote {result.out}: {result.messages} messages{lost}{chunks}")
    return 0
