# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-commands for bags: analyze, replay and bag recover."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli import common
from valve_control.control.parameters import files
from valve_control.control.parameters.table import NODES
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.logs import KINDS

if TYPE_CHECKING:
    from valve_control.recordings.analysis import ValveAnalysis
    from valve_control.recordings.report import Report


def add_commands(commands: Any) -> None:
    """Add analyze, replay and bag to the command's sub-commands."""
    shared = common.Parser(add_help=False)
    shared.add_argument(
        "bag",
        metavar="BAG",
        help=f"folder with metadata.yaml, an .mcap or .db3 file, or a log: {', '.join(KINDS)}",
    )
    common.bag_options(
        shared.add_argument_group("input"),
        "source of spool_command, spool_position or valve_voltage: any number of any message, such "
        "as spool_position=/joint_states.position[0]*250 (volts per unit after *, with an "
        "offset *1.25-15; or one of the words @%%, @0..10V, @4..20mA); boom/spool_position=... for a valve "
        "named boom; of a table: spool_position=COLUMN*1.25-15, time=COLUMN*0.001 in seconds or "
        "time=row*0.001 at 1 kHz",
        of=False,
    )
    common.output_group(
        shared,
        csv="aligned signals as CSV (of several valves: one file each)",
        html="one self-contained page with zoomable figures",
    )
    analyze = commands.add_parser(
        "analyze",
        parents=[shared],
        help="analyse a bag: sample rates, indices, estimates, spectra",
        description="Analyse a rosbag2 recording or a log, without ROS.",
    )
    analyze.set_defaults(run=_analyze)
    replay = commands.add_parser(
        "replay",
        parents=[shared],
        help="replay a bag: a controller on the recorded commands and readings",
        description="Shadow replay: a controller receives the recorded command and LVDT readings; its "
        "voltage is compared with the recorded one. 'valve-control simulate --command BAG' closes the loop "
        "with a simulated valve.",
    )
    replay.add_argument("--of", metavar="VALVE", help="valve to replay, if the bag has several")
    group = replay.add_argument_group("instead of the recorded parameters")
    common.law_option(group, "control law")
    common.parameter_options(group, "a parameter")
    replay.set_defaults(run=_replay)
    text = "copy a damaged or unfinished bag"
    bag = commands.add_parser("bag", help=text, description=f"{text.capitalize()}.")
    tasks = bag.add_subparsers(dest="bag_task", required=True, metavar="TASK")
    recover = tasks.add_parser(
        "recover",
        allow_abbrev=False,
        help="write a finished copy of an unfinished or damaged bag",
        description="Copy all that can be read of a bag, such as that of a killed recorder, into a new, "
        "finished bag. The bag itself stays as it is.",
    )
    recover.add_argument("bag", metavar="BAG", help="folder of the bag, or one file")
    recover.add_argument("--out", metavar="FOLDER", help="new bag (default: BAG_recovered)")
    common.output_group(recover)
    recover.set_defaults(run=_recover)


def _analyze(arguments: argparse.Namespace) -> None:
    from valve_control.recordings import analysis_report, axis_analysis
    from valve_control.recordings.analysis import analyze

    loaded = common.load(arguments, arguments.bag)
    result = analyze(loaded)
    ends = (arguments.start, arguments.end)
    part = (None if at is None else loaded.bag.begin + round(at * 1e9) for at in ends)
    report = analysis_report.of_bag(result, axis_analysis.axes(loaded.bag, *part))
    csv_files = _csv_files(arguments.csv, result.valves)
    common.check_outputs(arguments, *(csv_files.keys() - {arguments.csv}))
    _deliver(arguments, report, csv_files)


def _csv_files(path: str | None, valves: "dict[str, ValveAnalysis]") -> dict[str, str]:
    """Texts by path: one file, or one for each of several valves."""
    from valve_control.recordings.analysis_report import aligned_csv

    if path is None:
        return {}
    usable = {name: valve.signals for name, valve in valves.items() if valve.signals is not None}
    if not usable:
        raise BagError("there is nothing for --csv: no valve has readings that can be aligned")
    if len(usable) == 1:
        return {path: aligned_csv(*usable.values())}
    stem, ending = Path(path).with_suffix(""), Path(path).suffix
    return {f"{stem}_{name.replace('/', '_')}{ending}": aligned_csv(s) for name, s in usable.items()}


def _replay(arguments: argparse.Namespace) -> None:
    from valve_control.recordings import replay_report, shadow_replay
    from valve_control.recordings.analysis import analyze

    loaded = common.load(arguments, arguments.bag, journals=True)
    found = common.valve_of(arguments, arguments.bag, analyze(loaded).valves)
    left_out = [*loaded.problems, *found.left_out]
    changes = common.changes_of(arguments, recorded=True)
    why = "replay has the recorded command and readings"
    files.refuse_others(arguments.set, {"controller": NODES["controller"]}, why)
    readings = found.valve.signals.get("spool_position")
    with common.progress(0 if readings is None else len(readings.time), "samples") as bar:
        result = shadow_replay.replay(found.valve, changes["controller"], bar.update)
    result = result._replace(left_out=[*left_out, *result.left_out])
    report = replay_report.of_shadow(result, arguments.bag, found.valve.name)
    csv_files = {} if arguments.csv is None else {arguments.csv: common.csv_text(report.columns, "%.17g")}
    _deliver(arguments, report, csv_files)


def _deliver(arguments: argparse.Namespace, report: "Report", csv_files: Mapping[str, str]) -> None:
    """Print a report, and write it as HTML and JSON where asked for, and the ``csv_files``: texts by path."""
    if arguments.json != "-":
        print(report.text)
    for path, content in csv_files.items():
        common.deliver(arguments, path, content)
    if arguments.html is not None:
        common.deliver(arguments, arguments.html, report.html)
    common.write_json(arguments, report.about)


def _recover(arguments: argparse.Namespace) -> int:
    from valve_control.recordings.bags.recover import recover

    result = recover(Path(arguments.bag), Path(arguments.out) if arguments.out is not None else None)
    out = str(result.out) if result.out is not None else None
    common.write_json(arguments, {**result._asdict(), "bag": str(result.bag), "out": out})
    if result.messages == 0:
        common.say(arguments, f"{result.bag} holds no message that can be read; nothing was written")
        return 1
    if result.out is None:
        common.say(arguments, f"{result.bag} is whole ({result.messages} messages), nothing was written")
        return 0
    for problem in result.problems:
        common.say(arguments, f"note: {problem}")
    chunks = f", {result.damaged_chunks} damaged chunks left out" if result.damaged_chunks else ""
    lost = "" if result.lost is None else f", {result.lost} lost"
    common.say(arguments, f"wrote {result.out}: {result.messages} messages{lost}{chunks}")
    return 0
