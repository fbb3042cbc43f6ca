# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `export`: C99 or an FMU of a law, or of the simulated valve."""

import argparse
import os
from typing import Any

from valve_control import outputs
from valve_control.cli.common import check_outputs, parameter_options, tell_notes, write_json, wrote
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, defaults, updated


def add_commands(commands: Any) -> None:
    """Add export to the command's sub-commands."""
    options = commands.add_parser(
        "export",
        help="export a law, or the valve, as bit-identical C99 or as an FMU",
        description="Write a law with its parameters as C99 that is bit-identical to the Python: "
        "DIR/NAME.c, NAME.h, Makefile, check.c with check.csv (make -C DIR check) and README.md. Or "
        "write an FMU for co-simulation (Linux, x86-64) that contains the C.",
    )
    group = options.add_argument_group("export")
    group.add_argument("--controller", choices=LAWS, help="control law (default: arc)")
    group.add_argument(
        "--plant",
        choices=("valve",),
        help="export the simulated valve instead of a law",
    )
    group.add_argument(
        "--watch",
        action="store_true",
        help="export the law with the supervision of LVDT and command: gaps, 0 V on faults, limits",
    )
    parameter_options(group, "any parameter")
    output = options.add_argument_group("output")
    output.add_argument("--output", metavar="DIR", required=True, help="new folder, or new file of an FMU")
    output.add_argument(
        "--float", action="store_true", help="use float instead of double; needs a C compiler"
    )
    output.add_argument(
        "--fmu", type=int, choices=(2, 3), help="write an FMU of FMI 2.0 or 3.0; needs a C compiler"
    )
    output.add_argument(
        "--json", metavar="FILE", help="list of the exported items as JSON; - for standard output alone"
    )
    options.set_defaults(run=_export)


def _refuse_contradictions(arguments: argparse.Namespace) -> None:
    """Raise ParameterError for options that exclude each other."""
    if arguments.plant is not None and arguments.controller is not None:
        raise ParameterError("--controller and --plant contradict each other; give one of them")
    if arguments.watch and arguments.plant is not None:
        raise ParameterError("--watch is over the inputs of a law; leave out --plant")
    if arguments.watch and arguments.fmu is not None:
        raise ParameterError("an FMU has the law alone; leave out --watch")
    if arguments.watch and arguments.float:
        raise ParameterError("the watch counts time, for which float has too few digits; leave out --float")
    if arguments.fmu is None and arguments.output.lower().endswith(".fmu"):
        raise ParameterError(
            f"--output {arguments.output} is the name of an FMU, and C goes into a folder; --fmu 2 or "
            "--fmu 3 makes an FMU"
        )
    if arguments.fmu is not None and arguments.float:
        raise ParameterError("an FMU calculates in double; leave out --float")


def _export(arguments: argparse.Namespace) -> None:
    from tqdm import tqdm

    from valve_control.control.parameters import files
    from valve_control.export import fmu, folder, settable, unit

    path = folder.refuse_taken(arguments.output)
    check_outputs(arguments, [str(path)])
    _refuse_contradictions(arguments)
    notes: list[str] = []
    direct = {"controller": {"controller": arguments.controller}}
    changes = files.given(arguments.params_file, direct, arguments.set, notes)
    node, what = ("valve_simulator", "the valve") if arguments.plant else ("controller", "a law")
    files.refuse_others(arguments.set, {node: NODES[node]}, f"export writes {what} alone")
    tell_notes(notes)
    values = updated(NODES[node], defaults(NODES[node]), changes[node])
    if arguments.plant:
        chosen = unit.plant(values)
    else:
        chosen = (unit.watched if arguments.watch else unit.law)(values)
    with tqdm(total=len(chosen.table) + 1, unit="parameter", leave=False, disable=None) as bar:
        found = settable.find(chosen, bar.update)
        if arguments.fmu is not None:
            outputs.write(str(path), fmu.make(chosen, arguments.fmu, found))
            wrote(arguments, arguments.output)
        else:
            content = folder.files(chosen, arguments.float, found)
            folder.write(path, content)
            wrote(arguments, os.path.join(arguments.output, ""), f" with {', '.join(content)}")
    result = {
        "name": chosen.name,
        "watch": arguments.watch,
        "sample_period": chosen.period,
        "fmi": arguments.fmu,
        "number": "float" if arguments.float else "double",
        "output": arguments.output,
        "settable": sorted({setter.parameter.name for setter in found.setters}),
        "new_export": found.others,
    }
    write_json(arguments, result)
