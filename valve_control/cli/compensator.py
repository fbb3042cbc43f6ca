# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `compensator`: designs a pole-zero compensator."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

from valve_control.cli.common import check_outputs, deliver, output_group, write_json
from valve_control.control.parameters.table import NODES, VALVE
from valve_control.parameter import ParameterError, Values, defaults, lookup, updated

if TYPE_CHECKING:
    from valve_control.control.plant.models import TransferFunction
    from valve_control.design.identification.cancellation import Compensator


def add_commands(commands: Any) -> None:
    """Add compensator to the command's sub-commands."""
    options = commands.add_parser(
        "compensator",
        help="pole-zero compensator (section 3.3 of the paper) for any model and bandwidth",
        description="Design the compensator that cancels a valve's poles (and stable zeros) and leaves a "
        "Bessel low-pass. The model is that of a parameter file of identify (--from), (2) or (3) of the "
        "paper, or given by its polynomials.",
    )
    group = options.add_argument_group("the valve")
    group.add_argument("--from", dest="source", metavar="FILE", help="parameter file with a valve model")
    group.add_argument(
        "--model",
        choices=("second_order", "fourth_order"),
        help="model (2) or (3) of the paper (fourth_order)",
    )
    for part in ("numerator", "denominator"):
        group.add_argument(
            f"--{part}", type=float, nargs="+", metavar="C", help=f"{part} in s, highest power first"
        )
    group = options.add_argument_group("the compensator")
    group.add_argument(
        "--bandwidth", type=float, default=25.0, metavar="HZ", help="-3 dB bandwidth [Hz] (25)"
    )
    group.add_argument("--keep-zeros", action="store_true", help="cancel the poles only, as (13) does")
    group.add_argument(
        "--order", type=int, default=0, metavar="N", help="poles of the Bessel filter (one more than needed)"
    )
    group.add_argument(
        "--sample-period", type=float, default=0.001, metavar="S", help="sample period [s] (0.001)"
    )
    group.add_argument("--u-max", type=float, default=10.0, metavar="V", help="limit of the voltage [V] (10)")
    output_group(options, output="ROS 2 parameter file for the controller", figure="Bode plot as PNG or SVG")
    options.set_defaults(run=_compensator)


def _compensator(arguments: argparse.Namespace) -> None:
    from valve_control.design.identification import cancellation, result

    check_outputs(arguments, [arguments.output], [arguments.figure])
    numbers = {
        "compensator.bandwidth": arguments.bandwidth,
        "compensator.order": arguments.order,
        "sample_period": arguments.sample_period,
        "u_max": arguments.u_max,
    }
    for name, value in numbers.items():
        lookup(NODES["controller"], name).check(value)
    made = cancellation.make(
        _model(arguments),
        arguments.bandwidth,
        not arguments.keep_zeros,
        arguments.order,
        arguments.sample_period,
        arguments.u_max,
    )
    contents: list[tuple[str, str | bytes]] = []
    if arguments.output is not None:
        parameters = _parameters(arguments, made)
        result.check_parameters(parameters)
        comments = [
            f"Pole-zero compensator for {made.bandwidth:g} Hz:",
            f"  ({result.polynomial(made.transfer_function.numerator)})",
            f"  / ({result.polynomial(made.transfer_function.denominator)})",
            *(f"warning: {warning}" for warning in made.warnings),
        ]
        contents.append((arguments.output, result.parameter_file(parameters, comments)))
    if arguments.figure is not None:
        contents.append((arguments.figure, cancellation.bode_figure(made, arguments.figure)))
    if arguments.json != "-":
        print(_text(made))
    for path, content in contents:
        deliver(arguments, path, content)
    write_json(arguments, _dict(made))
    for warning in made.warnings:
        print(f"warning: {warning}", file=sys.stderr)


def _model(arguments: argparse.Namespace) -> "TransferFunction":
    from valve_control.control.parameters import build
    from valve_control.control.plant.models import MODELS
    from valve_control.design.identification import result

    polynomials = [p for p in (arguments.numerator, arguments.denominator) if p is not None]
    if (arguments.source is not None) + (arguments.model is not None) + bool(polynomials) > 1:
        raise ParameterError("give the model once: --from, --model, or --numerator with --denominator")
    if arguments.source is not None:
        return result.read_model(arguments.source)
    if polynomials:
        if len(polynomials) == 1:
            raise ParameterError("--numerator and --denominator need each other")
        given = {"valve": "custom", "numerator": arguments.numerator, "denominator": arguments.denominator}
        return build.valve_model(updated(VALVE, defaults(VALVE), given))
    return MODELS[arguments.model or "fourth_order"]


def _parameters(arguments: argparse.Namespace, made: "Compensator") -> dict[str, Values]:
    from valve_control.control.plant.models import MODELS
    from valve_control.design.identification.result import model_dict, with_period

    named = next((name for name, model in MODELS.items() if model == made.model), None)
    values: Values = {
        "controller": "compensator",
        "compensator.design": "designed",
        "compensator.model": named or "custom",
        "compensator.bandwidth": arguments.bandwidth,
        "compensator.order": arguments.order,
        "compensator.cancel_zeros": not arguments.keep_zeros,
    }
    if named is None:
        values |= {f"compensator.{part}": list(map(float, c)) for part, c in model_dict(made.model).items()}
    if arguments.u_max != 10.0:
        values["u_max"] = arguments.u_max
    return with_period({"controller": values}, made.period)


def _text(made: "Compensator") -> str:
    from valve_control.design.identification import bode
    from valve_control.design.identification.result import corners_text, model_text, polynomial, roots_text

    c = made.transfer_function
    return "\n".join(
        [
            f"valve: {model_text(made.model)}",
            f"  poles {roots_text(bode.roots(made.model.denominator))}; "
            f"zeros {roots_text(bode.roots(made.model.numerator))}",
            f"compensator: ({polynomial(c.numerator)})",
            f"  / ({polynomial(c.denominator)})",
            f"  poles {roots_text(bode.roots(c.denominator))}",
            f"  static gain {c.static_gain:.5g} V/V, largest {made.largest_gain:.4g} V/V at "
            f"{made.largest_at:.4g} Hz; largest step without saturation {made.largest_step:.3g} V",
            f"valve alone:            {corners_text(made.valve)}",
            f"with the compensator:   {corners_text(made.compensated)}",
            f"sampled every {1e3 * made.period:g} ms:     {corners_text(made.sampled)}",
        ]
    )


def _dict(made: "Compensator") -> dict[str, Any]:
    from valve_control.design.identification import bode, result

    return {
        "model": result.model_dict(made.model),
        "sample_period": made.period,
        **result.model_dict(made.transfer_function),
        "poles": [root._asdict() for root in bode.roots(made.transfer_function.denominator)],
        "static_gain": made.transfer_function.static_gain,
        "largest_gain": made.largest_gain,
        "largest_gain_hz": made.largest_at,
        "largest_step": made.largest_step,
        **{name: result.corners_dict(getattr(made, name)) for name in ("valve", "compensated", "sampled")},
        "warnings": list(made.warnings),
    }
