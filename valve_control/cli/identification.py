# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `identify`: measures and fits a valve, simulated or recorded."""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli.common import (
    bag_options,
    check_outputs,
    deliver,
    option_of,
    say,
    tell_notes,
    write_json,
    wrote,
)
from valve_control.cli.simulate import SCENARIOS, setup_options
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, Values, defaults, number, updated
from valve_control.recordings.bags.errors import BagError

if TYPE_CHECKING:
    from valve_control.design.identification.experiment import Experiment
    from valve_control.design.identification.result import Identification

SIMULATED = ("valve", "scenario", "command", "sample_period", "duration", "seed", "set", "params_file")
RECORDED = ("map", "of", "start", "end", "clock")
WRITING = ("task", "run", "line", "data_sheet", "output", "json")  # beside a data sheet


def add_commands(commands: Any) -> None:
    """Add identify to the command's sub-commands."""
    identify = commands.add_parser(
        "identify",
        parents=[setup_options()],
        conflict_handler="resolve",
        help="fit transfer functions of a valve to a simulated or recorded test",
        description="Measure the frequency response from voltage to LVDT and fit transfer functions like "
        "(2) and (3) with confidence bounds. Without a bag the test is simulated, without feedback: a "
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
    identify.add_argument(
        "bag", nargs="?", metavar="BAG", help="recorded stepped sine, sweep or other motion"
    )
    identify.add_argument(
        "--data-sheet",
        action="extend",
        nargs="*",
        metavar="NAME=VALUE",
        help="use the valve of a data sheet without a test (natural_frequency=18 damping=0.8 hysteresis=4); "
        "alone: list the names",
    )
    bag_options(identify.add_argument_group("with a bag"))
    group = identify.add_argument_group("measurement and fit")
    group.add_argument(
        "--settle",
        type=float,
        metavar="S",
        help="transient [s] that is left out at the beginning of each step (0.4)",
    )
    group.add_argument(
        "--band", type=float, nargs=2, metavar=("LOW", "HIGH"), help="fit only these frequencies [Hz]"
    )
    group.add_argument(
        "--order",
        type=int,
        choices=(2, 3, 4),
        help="order of the model that is fitted beside the second order (default: poles, zeros and dead "
        "time are chosen by the response)",
    )
    group.add_argument(
        "--sensor-delay",
        type=float,
        metavar="S",
        help="dead time of the sensor (0 s); the rest of the dead time belongs to the actuator, because "
        "readings alone cannot distinguish the two",
    )
    output = identify.add_argument_group("output")
    output.add_argument(
        "--output", metavar="FILE", help="ROS 2 parameter file: valve model, compensator's model, estimates"
    )
    output.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    output.add_argument(
        "--characteristic",
        action="append",
        default=[],
        metavar="FILE",
        help="with --friction: draw the characteristic curve in both directions as PNG or SVG, or write as "
        "YAML the parameters linearisation.* of its inverse; again for more (--json has its 100 points)",
    )
    output.add_argument("--figure", metavar="FILE", help="Bode plot as PNG or SVG")
    identify.set_defaults(run=_identify)


def _identify(arguments: argparse.Namespace) -> int:
    from valve_control.design.identification import characteristic, datasheet, result

    tables = [path for path in arguments.characteristic if Path(path).suffix.lower() in (".yaml", ".yml")]
    drawings = [path for path in arguments.characteristic if path not in tables]
    check_outputs(arguments, [arguments.output, *tables], [arguments.figure, *drawings])
    if arguments.data_sheet == []:
        say(arguments, "\n".join(row.described for row in datasheet.SHEET))
        write_json(arguments, {row.name: row.described for row in datasheet.SHEET})
        return 0
    tested = arguments.data_sheet is None
    found = _tested(arguments) if tested else _of_data_sheet(arguments)
    if arguments.characteristic and found.curve is None:
        raise ParameterError(
            "there is no characteristic curve: the slow triangle moved the spool to one side alone"
        )
    files: list[tuple[str, str | bytes]] = [(path, result.linearisation_text(found)) for path in tables]
    if arguments.output is not None or not tested:
        result.check_parameters(result.parameters(found))
    if arguments.output is not None:
        files.append((arguments.output, result.yaml_text(found)))
    if arguments.figure is not None:
        files.append((arguments.figure, result.bode_figure(found, arguments.figure)))
    if arguments.json != "-":
        print(result.text(found))
    for path, content in files:
        deliver(arguments, path, content)
    for path in drawings:
        assert found.curve is not None
        characteristic.draw(found.curve, path)
        wrote(arguments, path)
    write_json(arguments, result.as_dict(found))
    return 0


def _tested(arguments: argparse.Namespace) -> "Identification":
    """The valve of tests, simulated or recorded."""
    from valve_control.design.identification import identify

    if arguments.characteristic and arguments.friction is None:
        raise ParameterError("--characteristic comes from the slow triangle of --friction; give that too")
    if arguments.friction is not None and (arguments.friction == "") != (arguments.bag is None):
        raise ParameterError("--friction is a test of its own: give a bag for both tests or for none")
    request = identify.Request(
        settle=identify.SETTLE if arguments.settle is None else arguments.settle,
        band=None if arguments.band is None else tuple(arguments.band),
        order=arguments.order,
        sensor_delay=arguments.sensor_delay or 0.0,
    )
    request.check()
    tested, triangle = _simulated(arguments) if arguments.bag is None else _recorded(arguments)
    try:
        return identify.identified(tested, triangle, request)
    except ParameterError:
        tell_notes(tested.notes)  # on the recording: they may say why
        raise


def _of_data_sheet(arguments: argparse.Namespace) -> "Identification":
    """The valve of a data sheet."""
    from valve_control.control.parameters import files as parameter_files
    from valve_control.design.identification import datasheet

    others = [name for name in vars(arguments) if name not in WRITING]
    _refuse(arguments, others, "identify --data-sheet tests nothing, so it")
    nodes = {"sheet": datasheet.SHEET}
    return datasheet.valve(parameter_files.given([], {}, arguments.data_sheet, nodes=nodes)["sheet"])


def _refuse(arguments: argparse.Namespace, names: Iterable[str], who: str) -> None:
    """Raise ParameterError if one of the options ``names`` is there, which ``who`` takes not."""
    for name in names:
        if getattr(arguments, name) not in (None, [], False):
            raise ParameterError(f"{who} takes no {name if name == 'bag' else option_of(name)}")


def _simulated(arguments: argparse.Namespace) -> "tuple[Experiment, Experiment | None]":
    """Tests of the simulated valve: of its response, and of its friction if it is asked for."""
    from valve_control.control.commands import arrays
    from valve_control.control.parameters import files as parameter_files
    from valve_control.design.identification import experiment, friction

    _refuse(arguments, RECORDED, "identify without a bag")
    if arguments.command is not None:
        _refuse(arguments, ["scenario"], "identify with --command")
    direct: dict[str, dict[str, Any]] = {
        "controller": {},
        "valve_simulator": {"valve": arguments.valve, "seed": arguments.seed},
        "command_source": {"scenario": arguments.scenario, "duration": arguments.duration},
    }
    for options in direct.values():
        options["sample_period"] = arguments.sample_period
    notes: list[str] = []
    changes = parameter_files.given(arguments.params_file, direct, arguments.set, notes)
    tables = {node: NODES[node] for node in ("valve_simulator", "command_source")}
    parameter_files.refuse_others(arguments.set, tables, "identify tests the valve without feedback")
    tell_notes(notes)
    controller, valve = (
        updated(NODES[node], defaults(NODES[node]), changes[node])
        for node in ("controller", "valve_simulator")
    )
    period, test = number(valve, "sample_period"), changes["command_source"]
    if arguments.friction is not None and "amplitude" not in test:
        test = {"amplitude": friction.SHARE * number(valve, "u_max"), **test}
    command, motion = experiment.test_values(test, period), None
    if arguments.command is not None:
        motion = arrays.read(arguments.command)
        command = {**command, "scenario": "array"}
    tested = experiment.simulated(controller, valve, command, motion)
    if arguments.friction is None:
        return tested, None
    slow: Values = experiment.test_values(friction.TEST, period)
    return tested, experiment.simulated(controller, valve, slow)


def _recorded(arguments: argparse.Namespace) -> "tuple[Experiment, Experiment | None]":
    """Tests in bags: of the response, and of the friction if it is asked for."""
    from valve_control.design.identification import recorded
    from valve_control.recordings import mapping, recording

    _refuse(arguments, SIMULATED, "identify with a bag")
    paths = [path for path in (arguments.bag, arguments.friction) if path is not None]
    tests = []
    for path, start, end in (
        (arguments.bag, arguments.start, arguments.end),
        (arguments.friction, None, None),
    ):
        if path is None:
            continue
        maps = mapping.maps_of(path, arguments.map, paths)
        loaded = recording.load(path, maps, start, end, clock=arguments.clock)
        if not loaded.valves:
            raise BagError(f"{path} has no topic of a valve")
        tests.append(recorded.recorded(loaded, recording.chosen(path, loaded.valves, arguments.of)))
    return tests[0], recorded.longest(tests[1]) if len(tests) > 1 else None
