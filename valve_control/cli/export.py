"""Defines the sub-command `export`: C99 or an FMU of a law, or of the simulated valve."""

import argparse
import os
from typing import Any

from valve_control import outputs
from valve_control.cli.common import check_outputs, say, tell_notes, write_json
from valve_control.parameter import ParameterError, defaults, lookup, updated
from valve_control.parameters.table import NODES

CONTROLLERS = lookup(NODES["controller"], "controller").choices


def add_commands(commands: Any) -> None:
    """Add export to the command's sub-commands."""
    options = commands.add_parser(
        "export",
        help="a law, or the valve, as C99 or as an FMU, with the bits of the Python",
        description="Write a law with its parameters as C99 that gives the same bits as the Python it is "
        "made from: DIR/NAME.c, NAME.h, Makefile, check.c with check.csv (make -C DIR check) and README.md. "
        "Or an FMU for co-simulation (Linux, x86-64), with the C inside.",
    )
    group = options.add_argument_group("what is exported")
    group.add_argument("--controller", choices=CONTROLLERS, help="control law (default: arc)")
    group.add_argument("--plant", choices=("valve",), help="the simulated valve instead of a law")
    group.add_argument(
        "--watch",
        action="store_true",
        help="the law with the supervisor's watch over LVDT and command: gaps, 0 V on faults, limits",
    )
    group.add_argument(
        "--params-file",
        action="append",
        default=[],
        metavar="FILE",
        help="ROS 2 parameter file; again for more, later ones win; --set wins over files",
    )
    group.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="any parameter; again for more"
    )
    output = options.add_argument_group("what comes out")
    output.add_argument(
        "--output", metavar="DIR", required=True, help="folder, or file of an FMU, that is new"
    )
    output.add_argument(
        "--float", action="store_true", help="C in float in place of double; needs a C compiler"
    )
    output.add_argument(
        "--fmu", type=int, choices=(2, 3), help="an FMU of FMI 2.0 or 3.0; needs a C compiler"
    )
    output.add_argument(
        "--json", metavar="FILE", help="what was exported as JSON; - for standard output alone"
    )
    options.set_defaults(run=_export)


def _export(arguments: argparse.Namespace) -> None:
    from valve_control.export import fmu, folder, settable, unit
    from valve_control.parameters import files

    path = folder.refuse_taken(arguments.output)
    check_outputs(arguments)
    if arguments.plant is not None and arguments.controller is not None:
        raise ParameterError("--controller and --plant contradict each other; give one of them")
    if arguments.watch and arguments.plant is not None:
        raise ParameterError("--watch is over the inputs of a law; leave out --plant")
    if arguments.watch and arguments.fmu is not None:
        raise ParameterError("an FMU has the law alone; leave out --watch")
    if arguments.watch and arguments.float:
        raise ParameterError("the watch counts time, for which float has too few digits; leave out --float")
    if arguments.fmu is not None and arguments.float:
        raise ParameterError("an FMU calculates in double; leave out --float")
    notes: list[str] = []
    direct = {"controller": {"controller": arguments.controller}}
    changes = files.given(arguments.params_file, direct, arguments.set, notes)
    tell_notes(notes)
    node = "controller" if arguments.plant is None else "valve_simulator"
    values = updated(NODES[node], defaults(NODES[node]), changes[node])
    if arguments.plant is not None:
        chosen = unit.plant(arguments.plant, values)
    else:
        chosen = unit.watched(values) if arguments.watch else unit.law(values)
    found = settable.find(chosen)
    if arguments.fmu is not None:
        data = fmu.make(chosen, arguments.fmu, found)
        outputs.write(str(path), data)
        say(arguments, f"wrote {arguments.output}")
    else:
        made = folder.files(chosen, arguments.float, found)
        folder.write(path, made)
        say(arguments, f"wrote {os.path.join(arguments.output, '')} with {', '.join(made)}")
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
