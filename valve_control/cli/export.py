# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `export`: C99 or an FMU of a law, or of the simulated valve."""

import argparse
import os
from typing import Any

from valve_control import outputs
from valve_control.cli import common
from valve_control.control.parameters import files
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
    common.law_option(group)
    group.add_argument("--plant", choices=("valve",), help="export the simulated valve instead of a law")
    text = "export the law with the supervision of LVDT and command: gaps, 0 V on faults, limits"
    group.add_argument("--watch", action="store_true", help=text)
    common.parameter_options(group, "any parameter")
    output = common.output_group(options)
    text = "new folder, or new file of an FMU"
    output.add_argument("--output", dest="folder", metavar="DIR", required=True, help=text)
    output.add_argument("--float", action="store_true", help="float instead of double; needs a C compiler")
    output.add_argument("--fmu", type=int, choices=(2, 3), help="FMU of FMI 2.0 or 3.0; needs a C compiler")
    options.set_defaults(run=_export)


OTHERS = {  # options that go with none of others
    "plant": ("controller", "watch"),
    "watch": ("fmu", "float"),  # which counts time, for which float has too few digits
    "fmu": ("float",),
}


def _export(arguments: argparse.Namespace) -> None:
    from valve_control.export import fmu, folder, settable, unit

    path = folder.refuse_taken(arguments.folder)
    common.check_outputs(arguments, str(path))
    for name, others in OTHERS.items():
        if getattr(arguments, name):
            common.refuse(arguments, others, f"export --{name}")
    if arguments.fmu is None and arguments.folder.lower().endswith(".fmu"):
        raise ParameterError(
            f"--output {arguments.folder} is the name of an FMU, and C goes into a folder; --fmu 2 or "
            "--fmu 3 makes an FMU"
        )
    changes = common.changes_of(arguments)
    node, what = ("valve_simulator", "the valve") if arguments.plant else ("controller", "a law")
    files.refuse_others(arguments.set, {node: NODES[node]}, f"export writes {what} alone")
    values = updated(NODES[node], defaults(NODES[node]), changes[node])
    chosen = (unit.plant if arguments.plant else unit.supervised if arguments.watch else unit.law)(values)
    if not (arguments.plant or arguments.watch) and values["reshaping.lead"]:
        common.tell_notes(["the law alone has no lead of the command (reshaping.lead); --watch has it"])
    with common.progress(len(chosen.table) + 1, "parameters") as bar:
        found = settable.find(chosen, bar.update)
        if arguments.fmu is not None:
            outputs.write(str(path), fmu.make(chosen, arguments.fmu, found))
            common.wrote(arguments, arguments.folder, f" with {chosen.name}")
        else:
            content = folder.files(chosen, arguments.float, found)
            folder.write(path, content)
            common.wrote(arguments, os.path.join(arguments.folder, ""), f" with {', '.join(content)}")
    result = {
        "name": chosen.name,
        "watch": arguments.watch,
        "sample_period": chosen.period,
        "fmi": arguments.fmu,
        "number": "float" if arguments.float else "double",
        "output": arguments.folder,
        "settable": sorted({setter.parameter.name for setter in found.setters}),
        "new_export": found.others,
    }
    common.write_json(arguments, result)
