# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `margins`: how far given gains are from instability on a given valve."""

import argparse
import math
import sys
from typing import Any

from valve_control.cli.common import law_option, output_group, refuse, repeated, write_json
from valve_control.cli.simulate import settings_of, valve_options
from valve_control.cli.study import box_of
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import linear_loop, margins, stability
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import NODES
from valve_control.control.plant import registry
from valve_control.control.simulation import offline
from valve_control.parameter import ParameterError, word

SEED = 1  # of the valves within the box


def add_commands(commands: Any) -> None:
    """Add margins to the command's sub-commands."""
    options = commands.add_parser(
        "margins",
        parents=[valve_options()],
        help="gain, phase and delay margin of given gains on a valve or a box of valves",
        description="Margins of the sampled loop of one law around one valve, cut at the voltage: gain "
        "margins upwards and downwards, phase margin, delay margin, peaks of sensitivity and closed "
        "loop, and the largest oscillation about rest that friction sustains. With --box also the worst "
        "of each over the box of valves of `study` and `tune`.",
    )
    law_option(options)
    text = "also find the worst margins over the box of valves around this one"
    options.add_argument("--box", action="store_true", help=text)
    repeated(options, "--fix", "NAME", "with --box: quantity of the box that keeps its value")
    output_group(options)
    options.set_defaults(run=_margins)


def _margins(arguments: argparse.Namespace) -> None:
    from valve_control.design.tuning import box as boxes

    if not arguments.box:
        refuse(arguments, ["fix"], "margins without --box")
    settings = settings_of(arguments)
    judged = {node: NODES[node] for node in ("controller", "valve_simulator")}
    files.refuse_others(arguments.set, judged, "margins judges law and valve at rest")
    offline.check_agreement(settings["controller"], settings["valve_simulator"])
    law = LAWS[word(settings["controller"], "controller")]
    if not law.feedback:
        raise ParameterError(f"{law.name} has no feedback, so there is no loop that could have margins")
    params, plant = build.law_params(settings["controller"]), build.valve_params(settings["valve_simulator"])
    delay = registry.linear(plant).lvdt.delay
    if delay > stability.MOST_DELAY:
        raise ParameterError(
            f"the dead time of the LVDT is {delay:g} sample periods; margins are told up to "
            f"{stability.MOST_DELAY:g}"
        )
    values = settings["controller"]
    seen = margins.prepared(stability.behind_curve(values, plant))
    slopes = margins.margins(law, params, seen)  # one for each slope behind a curve
    found = {"this valve": margins.worst(slopes)}
    if arguments.box:
        plants = boxes.bounding(boxes.study_of(settings, box_of(arguments), 1, SEED))
        over = margins.margins(law, params, margins.prepared(plants))
        found[f"worst of {len(plants)} valves of the box"] = margins.worst(over)
    if arguments.json != "-":
        _print(law.name, found)
    warnings = [stability.warning(law, params), stability.valve_warning(law, params, plant, values)]
    for warning in filter(None, warnings):
        print(f"warning: {warning}", file=sys.stderr)
    rows = {name: margins.as_dict(one) for name, one in found.items()}
    loops = -linear_loop.law_response(linear_loop.linear_law(law, params), seen.z) * seen.response
    loop = loops[slopes.phase_deg.argmin()]
    response = {"frequency_hz": seen.omega / (2.0 * math.pi), "real": loop.real, "imaginary": loop.imag}
    write_json(arguments, {"controller": law.name, "margins": rows, "response": response})


def _print(law: str, found: dict[str, margins.Margins]) -> None:
    def text(value: float, scale: float, unit: str) -> str:
        return "without end" if math.isinf(value) else f"{scale * value + 0.0:.3g} {unit:4}"

    lines = {
        "gain may rise by": ("gain_db", "dB", 1.0),
        "gain may fall by": ("reduction_db", "dB", 1.0),
        "phase margin": ("phase_deg", "deg", 1.0),
        "delay margin": ("delay_s", "ms", 1e3),
        "sensitivity peak": ("sensitivity_db", "dB", 1.0),
        "closed-loop peak": ("response_db", "dB", 1.0),
        "swing from friction": ("swing_v", "V", 1.0),
        "largest pole": ("radius", "", 1.0),
    }
    print(f"{law:28}" + "".join(f"{name:>34}" for name in found))
    for label, (name, unit, scale) in lines.items():
        values = [text(float(getattr(one, name)[0]), scale, unit) for one in found.values()]
        print(f"{label:28}" + "".join(f"{value:>34}" for value in values).rstrip())
    for valve, one in found.items():
        if float(one.radius[0]) >= 1.0:
            print(f"{valve}: the loop is unstable, so no margin is left")
