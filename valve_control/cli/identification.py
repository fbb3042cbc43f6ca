# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `identify`: measures and fits a valve, simulated or recorded."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli import common
from valve_control.cli.simulate import PERIOD, SCENARIOS, motion, setup_options
from valve_control.control.parameters import files as parameter_files
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, Values, defaults, number, updated
from valve_control.recordings.bags.errors import BagError

if TYPE_CHECKING:
    from valve_control.design.identification.experiment import Experiment
    from valve_control.design.identification.result import Identification

SIMULATED = ("valve", "scenario", "command", "sample_period", "duration", "seed", "set", "params_file")
DELAY = (
    "dead time of the sensor (0 s); the rest of the dead time belongs to the actuator, because "
    "readings alone cannot distinguish the two"
)
WRITING = ("task", "run", "line", "data_sheet", "output", "json")  # beside a data sheet


def add_commands(commands: Any) -> None:
    """Add identify to the command's sub-commands."""
    identify = commands.add_parser(
        "identify",
        parents=[setup_options()],
        conflict_handler="resolve",
        help="fit transfer functions of a valve to a simulated or recorded test",
        description="Measure the frequency response from voltage to LVDT and fit transfer functions "
        "with confidence bounds. Without a bag the test is simulated, without feedback: a "
        "stepped sine from 0.5 to 100 Hz, or the test of --scenario (sweep, ...), --command or --set "
        "(frequency, end_frequency, steps, cycles, step_time, sweep_time, amplitude, offset; amplitude "
        "and offset in V of voltage).",
    )
    identify.add_argument("--scenario", choices=SCENARIOS[:-1], help="test signal (default: stepped_sine)")
    identify.add_argument("--duration", type=float, metavar="S", help="length [s] (that of the test signal)")
    identify.add_argument(
        "--friction",
        nargs="?",
        const="",
        metavar="BAG",
        help="also identify friction level and presliding from a slow triangle of the voltage, which is "
        "simulated or comes from a second BAG (scenario: triangle, amplitude: 4.0, frequency: 0.2, "
        "cycles: 9); the response of a stepped sine is then corrected for friction",
    )
    text = "recorded stepped sine, sweep or other motion"
    identify.add_argument("bag", nargs="?", metavar="BAG", help=text)
    identify.add_argument(
        "--data-sheet",
        action="extend",
        nargs="*",
        metavar="NAME=VALUE",
        help="use the valve of a data sheet without a test (natural_frequency=18 damping=0.8 hysteresis=4); "
        "alone: list the names",
    )
    common.bag_options(identify.add_argument_group("with a bag"))
    group = identify.add_argument_group("measurement and fit")
    text = "time [s] left out at the beginning of each step of frequency (0.4)"
    common.numbers(group, ("settle", float, None, "S", text), ("sensor-delay", float, None, "S", DELAY))
    text = "fit only these frequencies [Hz]"
    group.add_argument("--band", type=float, nargs=2, metavar=("LOW", "HIGH"), help=text)
    group.add_argument(
        "--order",
        type=int,
        choices=(2, 3, 4),
        help="order of the model that is fitted beside the second order (default: poles, zeros and dead "
        "time are chosen by the response)",
    )
    yaml = "ROS 2 parameter file: valve model and first gains for every law"
    output = common.output_group(identify, output=yaml, figure="Bode plot as PNG or SVG")
    common.repeated(
        output, "--characteristic", "FILE", "with --friction: draw the characteristic curve in both "
        "directions as PNG or SVG, or write as YAML the parameters linearisation.* of its inverse",
    )  # fmt: skip
    identify.set_defaults(run=_identify)


def _identify(arguments: argparse.Namespace) -> int:
    from valve_control.design.identification import characteristic, datasheet, result

    tables = [path for path in arguments.characteristic if Path(path).suffix.lower() in (".yaml", ".yml")]
    drawings = [path for path in arguments.characteristic if path not in tables]
    common.check_outputs(arguments, *arguments.characteristic)
    for path in drawings:
        common.check_figure(path)
    if arguments.data_sheet == []:
        common.say(arguments, "\n".join(row.described for row in datasheet.SHEET))
        common.write_json(arguments, {row.name: row.described for row in datasheet.SHEET})
        return 0
    tested = arguments.data_sheet is None
    found = _tested(arguments) if tested else _of_data_sheet(arguments)
    if arguments.characteristic and found.curve is None:
        text = "there is no characteristic curve: the slow triangle moved the spool to one side alone"
        raise ParameterError(text)
    files: list[tuple[str, str | bytes]] = [(path, result.linearisation_text(found)) for path in tables]
    if arguments.output is not None or not tested:
        result.check_parameters(result.parameters(found))
    if arguments.output is not None:
        files.append((arguments.output, result.yaml_text(found)))
    if arguments.json != "-":
        print(result.text(found))
    for path, content in files:
        common.deliver(arguments, path, content)
    if tested:
        arguments.draw = partial(result.draw_bode, found=found)
    if arguments.figure is not None:
        arguments.draw([Path(arguments.figure)])
        common.wrote(arguments, arguments.figure)
    for path in drawings:
        assert found.curve is not None
        characteristic.draw(found.curve, path)
        common.wrote(arguments, path)
    common.write_json(arguments, result.as_dict(found))
    return 0


def _tested(arguments: argparse.Namespace) -> "Identification":
    """The valve of tests, simulated or recorded."""
    from valve_control.design.identification import identify

    if arguments.characteristic and arguments.friction is None:
        raise ParameterError("--characteristic comes from the slow triangle of --friction; give that too")
    if arguments.friction is not None and (arguments.friction == "") != (arguments.bag is None):
        raise ParameterError("--friction is a test of its own: give a bag for both tests or for none")
    given = {name: getattr(arguments, name) for name in identify.Request._fields}
    request = identify.Request(**{name: value for name, value in given.items() if value is not None})
    request.check()
    tested, triangle = _simulated(arguments) if arguments.bag is None else _recorded(arguments)
    try:
        return identify.identified(tested, triangle, request)
    except ParameterError:
        common.tell_notes(tested.notes)  # on the recording: they may say why
        raise


def _of_data_sheet(arguments: argparse.Namespace) -> "Identification":
    """The valve of a data sheet."""
    from valve_control.design.identification import datasheet

    others = [name for name in vars(arguments) if name not in WRITING]
    common.refuse(arguments, others, "identify --data-sheet tests nothing, so it")
    nodes = {"sheet": datasheet.SHEET}
    return datasheet.valve(parameter_files.given([], {}, arguments.data_sheet, nodes=nodes)["sheet"])


def _simulated(arguments: argparse.Namespace) -> "tuple[Experiment, Experiment | None]":
    """Tests of the simulated valve: of its response, and of its friction if it is asked for."""
    from valve_control.design.identification import experiment, friction

    common.refuse(arguments, common.WITH_BAG, "identify without a bag")
    if arguments.command is not None:
        common.refuse(arguments, ["scenario"], "identify with --command")
    changes = common.changes_of(arguments)
    tables = {node: NODES[node] for node in ("valve_simulator", "command_source")}
    parameter_files.refuse_others(arguments.set, tables, "identify tests the valve without feedback")
    controller, valve = (
        updated(NODES[node], defaults(NODES[node]), changes[node])
        for node in ("controller", "valve_simulator")
    )
    period, test = number(valve, "sample_period"), changes["command_source"]
    if arguments.friction is not None and "amplitude" not in test:
        test = {"amplitude": friction.SHARE * number(valve, "u_max"), **test}
    command, numbers = experiment.test_values(test, period), None
    if arguments.command is not None:
        numbers = motion(arguments, arguments.command, period)
        command = {**command, "scenario": "array"}
    tested = experiment.simulated(controller, valve, command, numbers)
    if arguments.friction is None:
        return tested, None
    slow: Values = experiment.test_values(friction.TEST, period)
    return tested, experiment.simulated(controller, valve, slow)


def _recorded(arguments: argparse.Namespace) -> "tuple[Experiment, Experiment | None]":
    """Tests in bags: of the response, and of the friction if it is asked for."""
    from valve_control.design.identification import recorded

    if arguments.sample_period is not None:
        text = "it has its own; for a longer one thin the log, such as every second row"
        raise ParameterError(f"identify with a bag takes no --sample-period: {text}")
    common.refuse(arguments, SIMULATED, "identify with a bag")
    paths = [path for path in (arguments.bag, arguments.friction) if path is not None]
    tests = []
    for path, part in zip(paths, ({}, {"start": None, "end": None}), strict=False):  # of a triangle all
        try:
            loaded = common.load(arguments, path, **part)
        except BagError as error:
            if not arguments.map or len(paths) == 1:
                raise
            both = "--map counts for both tests: give two bags, or two tables with the same columns"
            raise BagError(f"{error} ({both})") from error
        tests.append(recorded.recorded(loaded, common.valve_of(arguments, path, loaded.valves)))
    if (period := tests[0].period) != PERIOD:
        one = f"{1e3 * period:.4g} ms"
        common.tell_notes([f"sample period {one}, as recorded; a motion has one number per {one}"])
    return tests[0], tests[1] if len(tests) > 1 else None
