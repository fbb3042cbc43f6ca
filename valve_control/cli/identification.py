# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `identify`: measures and fits a valve, simulated or recorded."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli.common import (
    Progress,
    bag_options,
    check_outputs,
    deliver,
    tell_notes,
    write_json,
)
from valve_control.cli.simulate import SCENARIOS, setup_options
from valve_control.control.parameters.table import NODES
from valve_control.design.identification import WEIGHTINGS
from valve_control.parameter import ParameterError, Values, defaults, number, updated
from valve_control.recordings.bags.errors import BagError

if TYPE_CHECKING:
    from valve_control.design.identification.characteristic import Characteristic
    from valve_control.design.identification.experiment import Experiment
    from valve_control.design.identification.friction import Friction
    from valve_control.design.identification.rational import Fit
    from valve_control.design.identification.response import Response
    from valve_control.design.identification.result import Identification

SIMULATED = ("valve", "scenario", "command", "sample_period", "duration", "seed", "set", "params_file")
CURVE_TABLES = (".csv", ".json", ".yaml", ".yml")
FRICTION_ROUNDS = 2  # the friction needs the model, and the model the friction
MEASURED = (
    "bag", "valve", "scenario", "command", "duration", "seed", "params_file", "friction", "settle", "band",
    "order", "zeros", "delay", "sensor_delay", "weighting", "csv", "figure",
    "characteristic",
)  # fmt: skip
USUAL = {"settle": 0.4, "sensor_delay": 0.0, "weighting": "likelihood"}
BAG_ONLY = ("map", "of", "start", "end", "clock")


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
    bag_options(identify.add_argument_group("with a bag"))
    _fit_options(identify.add_argument_group("measurement and fit"))
    output = identify.add_argument_group("output")
    output.add_argument(
        "--output", metavar="FILE", help="ROS 2 parameter file: valve model, compensator's model, estimates"
    )
    output.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    output.add_argument("--csv", metavar="FILE", help="measured response as CSV")
    output.add_argument(
        "--characteristic",
        action="append",
        default=[],
        metavar="FILE",
        help="with --friction: write the characteristic curve in both directions, 100 points, as CSV, "
        "JSON, PNG or SVG, or as YAML the parameters linearisation.* of its inverse; again for more",
    )
    output.add_argument("--figure", metavar="FILE", help="Bode plot as PNG or SVG")
    identify.set_defaults(run=_identify)


def _fit_options(group: Any) -> None:
    group.add_argument(
        "--settle",
        type=float,
        default=USUAL["settle"],
        metavar="S",
        help="transient [s] that is left out at the beginning of each step (0.4)",
    )
    group.add_argument(
        "--band", type=float, nargs=2, metavar=("LOW", "HIGH"), help="fit only these frequencies [Hz]"
    )
    group.add_argument(
        "--second-order",
        type=_second_order,
        metavar="HZ,DAMPING,GAIN",
        help="use a valve with this natural frequency, damping and static gain [V/V] without a test, for "
        "example from a data sheet; accepts --set of u_max, lvdt.noise, lvdt.resolution and lvdt.delay",
    )
    group.add_argument(
        "--order",
        type=int,
        choices=(2, 3, 4),
        help="order of the model that is fitted beside the second order (default: poles, zeros and dead "
        "time are chosen by the response)",
    )
    group.add_argument("--zeros", type=int, metavar="N", help="zeros of that model (order - 2)")
    group.add_argument("--delay", action="store_true", help="also estimate a dead time")
    group.add_argument(
        "--sensor-delay",
        type=float,
        default=0.0,
        metavar="S",
        help="dead time of the sensor (0 s); the rest of the dead time belongs to the actuator, because "
        "readings alone cannot distinguish the two",
    )
    group.add_argument(
        "--weighting",
        choices=WEIGHTINGS,
        default=USUAL["weighting"],
        help="weight of the errors: likelihood: by uncertainty; relative: in per cent; uniform: in volts "
        "(default: likelihood)",
    )


def _identify(arguments: argparse.Namespace) -> int:
    from valve_control import outputs
    from valve_control.design.identification import dead_time, result

    _check_curve(arguments)
    if arguments.second_order is not None:
        return _given(arguments)
    _check_order(arguments)
    if arguments.delay and _is_number(arguments.bag):
        raise ParameterError(
            f"--delay takes no number, because the dead time is estimated; leave out {arguments.bag} (a "
            "simulated valve gets its own with --set lvdt.delay=SECONDS)"
        )
    dead_time.check(arguments.sensor_delay)
    if not 0.0 <= arguments.settle < float("inf"):
        raise ParameterError(f"--settle is {arguments.settle:g} s; it must be finite and not negative")
    band = None
    if arguments.band is not None:
        low, high = arguments.band
        if not 0.0 < low < high < float("inf"):
            raise ParameterError(f"--band {low:g} {high:g} must be two rising frequencies above 0 Hz")
        band = (low, high)
    if arguments.friction is not None:
        _check_friction(arguments)
    rounds = 1 if arguments.friction is None else 1 + FRICTION_ROUNDS
    progress = Progress(1 + rounds, "steps of the identification")
    progress(0)
    tested = _recorded(arguments) if arguments.bag is not None else _simulated(arguments)
    progress(1)
    triangle = None if arguments.friction is None else _triangle(arguments)
    if triangle is not None and triangle.period != tested.period:
        raise ParameterError(
            f"the friction test has a sample period of {triangle.period:g} s, the other one of "
            f"{tested.period:g} s; they must agree"
        )
    found = _rounds(arguments, tested, triangle, band, progress)
    wanted: list[tuple[str | None, Callable[[], str | bytes]]] = [
        (arguments.output, lambda: result.yaml_text(found)),
        (arguments.csv, lambda: result.csv_text(found.measured)),
        (arguments.figure, lambda: result.bode_figure(found, arguments.figure)),
        (arguments.json if arguments.json != "-" else None, lambda: outputs.as_json(result.as_dict(found))),
    ]
    wanted += [(path, lambda path=path: _curve(found, path)) for path in arguments.characteristic]  # type: ignore[misc]
    made = [(path, make()) for path, make in wanted if path is not None]
    if arguments.output is not None:
        result.check_parameters(result.parameters(found))
    if arguments.json != "-":
        print(result.text(found))
    for path, content in made:
        deliver(arguments, path, content)
    if arguments.json == "-":
        print(outputs.as_json(result.as_dict(found)), end="")
    return 0


def _second_order(text: str) -> tuple[float, float, float]:
    """Natural frequency [Hz], damping and static gain [V/V] out of ``text``."""
    try:
        frequency, damping, gain = map(float, text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"'{text}' must be natural frequency [Hz], damping and static gain, such as 18,0.8,1.05"
        ) from error
    return frequency, damping, gain


def _given(arguments: argparse.Namespace) -> int:
    """Write what follows from natural frequency, damping and static gain, without a test."""
    from valve_control.control.parameters import files as parameter_files
    from valve_control.design.identification import datasheet, result

    named = {name: getattr(arguments, name) for name in (*MEASURED, *BAG_ONLY)}
    for name, value in named.items():
        if value not in (None, [], False, USUAL.get(name)):
            option = {"bag": "bag", "start": "--from", "end": "--to"}.get(name) or f"--{name}".replace(
                "_", "-"
            )
            raise ParameterError(f"identify --second-order measures nothing, so it takes no {option}")
    direct = {"valve_simulator": {"sample_period": arguments.sample_period}}
    for text in arguments.set:
        name, _ = parameter_files.parse_setting(text)
        if name not in datasheet.SETTABLE:
            raise ParameterError(
                f"identify --second-order takes --set of {', '.join(datasheet.SETTABLE)}, not of {name}"
            )
    changes = parameter_files.given([], direct, arguments.set)["valve_simulator"]
    table = NODES["valve_simulator"]
    frequency, damping, gain = arguments.second_order
    found = datasheet.second_order(frequency, damping, gain, updated(table, defaults(table), changes))
    result.check_parameters(datasheet.parameters(found))
    if arguments.json != "-":
        print(datasheet.text(found))
    if arguments.output is not None:
        deliver(arguments, arguments.output, datasheet.yaml_text(found))
    write_json(arguments, datasheet.as_dict(found))
    return 0


def _check_order(arguments: argparse.Namespace) -> None:
    """Raise ParameterError for zeros that no model of the wanted order has."""
    order, zeros = arguments.order, arguments.zeros
    if zeros is None:
        return
    if order is None:
        raise ParameterError("--zeros needs --order")
    if not 0 <= zeros <= order - 2:
        raise ParameterError(
            f"--zeros is {zeros}; a valve of order {order} has at least 0 and at most {order - 2}, two fewer "
            "than poles"
        )


def _is_number(text: str | None) -> bool:
    """Whether the name of a bag is a number, and no such bag is there."""
    try:
        return text is not None and not Path(text).exists() and math.isfinite(float(text))
    except ValueError:
        return False


def _check_friction(arguments: argparse.Namespace) -> None:
    """Raise ParameterError unless both tests are simulated, or both recorded."""
    if arguments.friction == "" and arguments.bag is not None:
        raise ParameterError(
            f"--friction needs a bag with a triangle of its own beside {arguments.bag}; the command source "
            "makes one with scenario triangle"
        )
    if arguments.friction != "" and arguments.bag is None:
        raise ParameterError(
            f"--friction {arguments.friction} comes from a bag and the response from a simulated valve; give "
            "a bag for both or for none"
        )


def _rounds(
    arguments: argparse.Namespace,
    tested: "Experiment",
    triangle: "Experiment | None",
    band: tuple[float, float] | None,
    progress: Progress,
) -> "Identification":
    """What both tests give: the friction needs the lag of the model, and the model what friction leaves."""
    from valve_control.design.identification import characteristic, experiment, friction

    seen = measured = experiment.estimate(tested, arguments.settle, band)
    fits, told = _fits(arguments, tested, measured)
    progress(2)
    rubbing, curve = None, None
    if triangle is not None:
        for done in range(FRICTION_ROUNDS):
            lag = friction.lag_of(fits[-1].model, fits[-1].delay)
            rubbing, curve = characteristic.with_friction(triangle, lag)
            slipping, played = (
                _slipping(tested, rubbing, curve, measured) if tested.segments else (tested, False)
            )
            measured = experiment.estimate(slipping, arguments.settle, band)
            measured = friction.unsure(measured, seen) if played else measured
            fits, told = _fits(arguments, tested, measured)
            progress(3 + done)
    return _found(arguments, tested, measured, fits, told, rubbing, curve)


def _slipping(
    tested: "Experiment", rubbing: "Friction", curve: "Characteristic | None", measured: "Response"
) -> tuple["Experiment", bool]:
    """``tested`` without friction, and whether without the play of a magnet that the ``curve`` tells, too.

    The coil of that magnet is a pole of the model without zeros that is nearest to ``measured``.
    """
    from valve_control.design.identification import first_gains, friction, rational

    own = first_gains.without_play(rubbing, curve)
    assert own is not None
    if own is rubbing or curve is None or curve.shares is None or rubbing.presliding == 0.0:
        return friction.without(tested, rubbing), False  # swings at its turns, or its overlap hides the play
    try:
        magnet = first_gains.magnet_of(rational.fit(measured, 3, 0, True).model, curve)
    except ParameterError:
        magnet = None
    return friction.without(tested, own, curve.shares.play, 0.0 if magnet is None else magnet.coil), True


def _check_curve(arguments: argparse.Namespace) -> None:
    """Check the files that come out. Raises ParameterError."""
    tables = [path for path in arguments.characteristic if Path(path).suffix.lower() in CURVE_TABLES]
    drawings = [path for path in arguments.characteristic if path not in tables]
    for path in drawings:
        if Path(path).suffix.lower() not in (".png", ".svg"):
            raise ParameterError(
                f"--characteristic {path} must end in {', '.join(CURVE_TABLES)}, .png or .svg"
            )
    check_outputs(arguments, [arguments.output, arguments.csv, *tables], [arguments.figure, *drawings])
    if arguments.characteristic and arguments.friction is None:
        raise ParameterError("--characteristic comes from the slow triangle of --friction; give that too")


def _curve(found: "Identification", path: str) -> str | bytes:
    """The characteristic curve as the file ``path``. Raises ParameterError if there is none."""
    from valve_control import outputs
    from valve_control.design.identification import characteristic

    if found.curve is None:
        raise ParameterError(
            "there is no characteristic curve: the slow triangle moved the spool to one side alone"
        )
    ending = Path(path).suffix.lower()
    if ending == ".csv":
        return characteristic.csv_text(found.curve)
    if ending == ".json":
        return outputs.as_json(characteristic.as_dict(found.curve))
    if ending in (".yaml", ".yml"):
        from valve_control.design.identification import result

        return result.linearisation_text(found)
    return characteristic.figure(found.curve, path)


def _triangle(arguments: argparse.Namespace) -> "Experiment":
    """The friction test: of the simulated valve, or out of a bag."""
    if arguments.friction == "":
        return _simulated(arguments, True)
    from valve_control.recordings import tables

    maps = tables.maps_of(arguments.friction, arguments.map, [arguments.bag, arguments.friction])
    told = {"bag": arguments.friction, "start": None, "end": None, "map": maps}
    return _recorded(argparse.Namespace(**{**vars(arguments), **told}))


def _simulated(arguments: argparse.Namespace, triangle: bool = False) -> "Experiment":
    """A test of the simulated valve; ``triangle``: that of its friction."""
    from valve_control.control.parameters import files as parameter_files
    from valve_control.design.identification import experiment, friction

    for name in BAG_ONLY:
        if getattr(arguments, name) not in (None, []):
            option = {"start": "from", "end": "to"}.get(name, name)
            raise ParameterError(f"identify without a bag takes no --{option}")
    direct: dict[str, dict[str, Any]] = {
        "controller": {},
        "valve_simulator": {"valve": arguments.valve, "seed": arguments.seed},
        "command_source": {"scenario": arguments.scenario, "duration": arguments.duration},
    }
    for options in direct.values():
        options["sample_period"] = arguments.sample_period
    if arguments.command is not None and arguments.scenario is not None:
        raise ParameterError(
            f"--command {arguments.command} and --scenario {arguments.scenario} contradict each other; "
            "give one of them"
        )
    told: list[str] = []
    given = parameter_files.given(arguments.params_file, direct, arguments.set, told)
    tested = {node: NODES[node] for node in ("valve_simulator", "command_source")}
    parameter_files.refuse_others(arguments.set, tested, "identify tests the valve without feedback")
    tell_notes(told)
    settings: dict[str, Values] = {
        node: updated(NODES[node], defaults(NODES[node]), given[node])
        for node in ("controller", "valve_simulator")
    }
    period = number(settings["valve_simulator"], "sample_period")
    motion = None
    if triangle:
        command = experiment.test_values(friction.TEST, period)
        return experiment.simulated(settings["controller"], settings["valve_simulator"], command)
    test = given["command_source"]
    if arguments.friction is not None and "amplitude" not in test:
        test = {"amplitude": friction.SHARE * number(settings["valve_simulator"], "u_max"), **test}
    command = experiment.test_values(test, period)
    if arguments.command is not None:
        from valve_control.control.commands import arrays

        motion = arrays.read(arguments.command)
        command = {**command, "scenario": "array"}
    return experiment.simulated(settings["controller"], settings["valve_simulator"], command, motion)


def _recorded(arguments: argparse.Namespace) -> "Experiment":
    from valve_control.design.identification import recorded
    from valve_control.recordings import recording, tables

    for name in SIMULATED:
        if getattr(arguments, name) not in (None, []):
            raise ParameterError(
                f"identify with a bag takes no --{name.replace('_', '-')}, which is for simulation"
            )
    if arguments.start is not None and arguments.end is not None and arguments.end <= arguments.start:
        raise ParameterError(f"--to {arguments.end:g} lies not after --from {arguments.start:g}")
    paths = [path for path in (arguments.bag, arguments.friction) if path]
    maps = tables.maps_of(arguments.bag, arguments.map, paths)
    loaded = recording.load(arguments.bag, maps, arguments.start, arguments.end, clock=arguments.clock)
    if not loaded.valves:
        raise BagError(f"{arguments.bag} has no topic of a valve")
    valve = recording.chosen(arguments.bag, loaded.valves, arguments.of)
    return recorded.recorded(loaded, valve)


def _found(
    arguments: argparse.Namespace,
    tested: "Experiment",
    measured: "Response",
    fits: list["Fit"],
    told: list[str],
    rubbing: "Friction | None",
    curve: "Characteristic | None",
) -> "Identification":
    from valve_control.design.identification import (
        characteristic,
        dead_time,
        experiment,
        first_gains,
        friction,
        lvdt,
        result,
        theta,
    )

    second = fits[0]
    notes = [*tested.notes, *measured.notes, *told]
    if tested.feedback:
        law = tested.feedback
        notes.append(
            f"the voltage came from {law}, which feeds noise of the reading back: the response is biased"
        )
    best = fits[-1]
    notes = [*experiment.excitation_notes(measured, fits), *notes]
    notes += experiment.coherence_notes(measured)
    notes += experiment.range_notes(measured, second, best, arguments.bag is None)
    if rubbing is not None:
        notes += friction.offset_notes(rubbing)
    if curve is not None:
        notes += characteristic.notes(curve, tested.u_max)
    suggestion = theta.suggest(measured, second, best, tested.u_max)
    readings = lvdt.observe(tested.position)
    model, delay, late = first_gains.with_dead_time(measured, best, arguments.weighting)
    sensor = arguments.sensor_delay
    gains = first_gains.first(
        first_gains.KnownValve(
            model=model,
            delay=delay,
            theta=suggestion,
            lvdt=readings,
            period=measured.period,
            u_max=tested.u_max,
            friction=first_gains.without_play(rubbing, curve),
            sensor_delay=sensor,
            magnet=first_gains.magnet_of(model, curve),
        )
    )
    return result.Identification(
        source=tested.source,
        measured=measured,
        fits=tuple(fits),
        best=best,
        theta=suggestion,
        lvdt=readings,
        gains=gains.values,
        u_max=tested.u_max,
        notes=(*notes, *late, *dead_time.notes(delay, sensor), *gains.notes),
        friction=rubbing,
        curve=curve,
    )


def _fits(
    arguments: argparse.Namespace, tested: "Experiment", measured: "Response"
) -> tuple[list["Fit"], list[str]]:
    """The second order for the estimates, then the model that stands for the valve if it is another; notes.

    Without --order the response chooses. A second order that misses it then has a dead time too.
    """
    from valve_control.design.identification import rational, structure

    options = {"delayed": arguments.delay, "weighting": arguments.weighting}
    try:
        second = _second(tested, measured, **options)
    except ParameterError as error:
        if arguments.order is not None or arguments.delay:
            raise
        try:
            second = _second(tested, measured, True, arguments.weighting)
        except ParameterError:
            raise error from None
    if arguments.order is None:
        chosen, note = structure.beside(measured, second, **options)
        return ([second], [note]) if chosen is None else ([second, chosen], [])
    if arguments.order == 2:
        return [second], []
    higher = rational.fit(measured, arguments.order, arguments.zeros, **options)
    rational.check_worth(higher)
    return [second, higher], []


def _second(tested: "Experiment", measured: "Response", delayed: bool, weighting: str) -> "Fit":
    """The second order. Raises ParameterError if it says nothing of the valve."""
    from valve_control.design.identification import experiment, rational

    try:
        second = rational.fit(measured, 2, delayed=delayed, weighting=weighting)
        experiment.check_travel(tested, second.model.static_gain)
        rational.check_worth(second)
    except ParameterError as error:
        if not tested.feedback:
            raise
        raise ParameterError(
            f"{tested.source} was recorded in closed loop ({tested.feedback}), which does not show the valve "
            f"alone: {error}; record a stepped sine or sweep with controller open_loop"
        ) from error
    return second
