# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `tune`: the best gains of any law for a box of valves, verified."""

import argparse
import math
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli import common
from valve_control.cli.simulate import delivery_of, delivery_options, motion, settings_of, setup_options
from valve_control.cli.study import FIX, box_of
from valve_control.control.parameters import build, files, ros_file
from valve_control.parameter import Values, number, word

if TYPE_CHECKING:
    from valve_control.design.tuning.request import Task
    from valve_control.design.tuning.trial import TuningLimits, TuningMotion
    from valve_control.design.tuning.tuner import Tuned

DELIVERY = ("command_period", "command_jitter", "command_drift")
FAILED = 1  # exit status if gains of a law are not accepted


def _limit(off: float, least: float, most: float, unit: float = 1.0) -> Callable[[str], float]:
    """Type of a limit in such a ``unit``; ``off``: its value for "none"."""
    number = common.within(least, most)
    return lambda text: off if text == "none" else unit * number(text)


LIMITS: dict[str, common.Row] = {  # on every valve of the box, by fields of TuningLimits
    "gain_db": ("gain-margin", _limit(0.0, 0.0, 60.0), "3", "dB", "least gain margin, up and down"),
    "phase_deg": ("phase-margin", _limit(0.0, 0.0, 120.0), "20", "deg", "least phase margin"),
    "delay_s": ("delay-margin", _limit(0.0, 0.0, 1.0), "0.0005", "S", "least delay margin [s]"),
    "pause_s": ("pause", _limit(0.0, 0.0, 0.05), "0.01", "S", "longest harmless pause of the command"),
    "sensitivity_db": ("peak", _limit(math.inf, 0.1, 1e3), "12", "dB", "largest peak of the sensitivity"),
    "swing": ("swing", _limit(math.inf, 0.001, 1e3), "0.04", "V", "largest swing about rest by friction"),
    "saturated": ("saturation", _limit(math.inf, 0.0, 1.0), "0.02", "X", "largest share of samples at u_max"),
    "overshoot": ("overshoot", _limit(math.inf, 0.0, 1e3, 0.01), "5", "%", "largest overshoot of steps"),
}


def add_commands(commands: Any) -> None:
    """Add tune to the command's sub-commands."""
    tune = commands.add_parser(
        "tune",
        parents=[setup_options(several=True), delivery_options(points=False)],
        help="search and verify the gains of laws for a valve and its spread",
        description="Search the gains of one or more laws. The objective is a small error of the true "
        "position at limited chatter, on valves drawn from the study's box around a valve. The sampled "
        "loop has to keep its margins all over the box. Gains are written only if they pass a "
        "verification with other valves, noise and commands. --seed is the seed of the search.",
    )
    text = "laws to tune, or all (default: that of the parameter files)"
    tune.add_argument("--controller", metavar="LAW,…", help=text)
    group = tune.add_argument_group("objective")
    text = "limit of the mean chatter c_u (%(default)s); if no gains keep it, 1.25 times the least"
    common.numbers(group, ("max-chatter", common.within(1e-6, 1e3), common.CHATTER, "RATIO", text))
    group.add_argument("--preview", action="store_true", help="commands have derivatives (spool_trajectory)")
    group = tune.add_argument_group("limits on every valve of the box", "The word none switches a limit off.")
    common.numbers(group, *((*row[:4], f"{row[4]} (%(default)s)") for row in LIMITS.values()))
    group = tune.add_argument_group("search")
    text = "sets of gains that are tried for each law, of a PID for each form (%(default)s)"
    common.numbers(
        group,
        ("valves", common.VALVES, 8, "N", "number of valves in the search (%(default)s)"),
        ("unseen", common.VALVES, 64, "N", "number of valves in the verification (%(default)s)"),
        ("budget", common.BUDGET, 4000, "N", text),
        common.THREADS,
    )
    common.repeated(group, *FIX)
    common.output_group(tune, output="ROS 2 parameter file; with several laws NAME_LAW.yaml for each")
    tune.set_defaults(run=_tune)


def _tune(arguments: argparse.Namespace) -> int:
    from valve_control.design.tuning import request, tuner

    if arguments.preview:
        common.refuse(arguments, DELIVERY, "tune --preview")
    task = _task(arguments)
    paths = _paths(arguments.output, [law.name for law in task.laws])
    common.check_outputs(arguments, *(set(paths.values()) - {arguments.output}))
    common.tell_notes(task.notes)
    with common.progress(sum(request.budgets(task, arguments.budget)), "sets of gains") as bar:

        def show(done: int, law: str) -> None:
            bar.set_postfix_str(law, refresh=False)
            bar.update(done - bar.n)

        tuned, missing = request.search(
            task, arguments.max_chatter, arguments.budget, arguments.threads, show
        )
    holding = {name: one for name, one in tuned.items() if one.chosen.holds}
    written = {name: paths[name] for name in holding if paths}
    laws = {name: {**tuner.as_dict(one), "file": written.get(name)} for name, one in tuned.items()}
    result = {"laws": laws, **({"missing": missing} if missing else {})}
    for text in missing.values():
        print(text, file=sys.stderr)
    for name, one in tuned.items():
        reasons = [f"not accepted, because {reason}" for reason in one.chosen.verified.reasons]
        for text in (*reasons, *one.notes):
            print(f"{name}: {text}", file=sys.stderr)
    if tuned and arguments.json != "-":
        _print(tuned)
    for name, one in holding.items():
        text = _yaml(arguments, task.seen.values, one)
        if name in written:
            common.deliver(arguments, written[name], text)
        elif arguments.json is None:
            print(text, end="")
    common.write_json(arguments, result)
    return 0 if len(holding) == len(task.laws) else FAILED


def limits_of(arguments: argparse.Namespace) -> "TuningLimits":
    """The limits that the options name."""
    from valve_control.design.tuning.trial import TuningLimits

    return TuningLimits(
        **{field: getattr(arguments, name.replace("-", "_")) for field, (name, *_) in LIMITS.items()}
    )


def _task(arguments: argparse.Namespace) -> "Task":
    """What the options ask for. Raises ParameterError."""
    from valve_control.design.tuning import request

    settings = settings_of(argparse.Namespace(**{**vars(arguments), "controller": None, "command": None}))
    valve = {"valve_simulator": {"valve": arguments.valve}}
    chosen = files.given(arguments.params_file, valve, arguments.set)["controller"]
    laws = request.laws_of(arguments.controller or word(settings["controller"], "controller"))
    request.check_free([text.partition("=")[0].strip() for text in arguments.set], laws)
    task = request.task_of(
        laws=laws,
        settings=settings,
        chosen=chosen,
        quantities=box_of(arguments),
        valves=arguments.valves,
        unseen=arguments.unseen,
        seed=arguments.seed,
        motions=_motions(arguments, settings),
        limits=limits_of(arguments),
        preview=arguments.preview,
        delivery=None if arguments.preview else delivery_of(arguments, settings["controller"]),
    )
    if "friction.coulomb" in arguments.fix and settings["valve_simulator"]["friction.coulomb"] == 0.0:
        task.notes.append("friction.coulomb is fixed at 0 V; --set friction.coulomb=V sets the friction")
    return task


def _motions(arguments: argparse.Namespace, settings: Mapping[str, Values]) -> list["TuningMotion"]:
    from valve_control.design.tuning import request

    if not arguments.command:
        source = settings["command_source"]
        return [request.motion_of(word(source, "scenario"), build.commands(source), settings)]
    common.refuse(arguments, ["scenario"], "tune --command")
    period = number(settings["command_source"], "sample_period")
    read = ((Path(file).name, motion(arguments, file, period)) for file in arguments.command)
    return [request.motion_of(name, numbers, settings) for name, numbers in read]


def _paths(output: str | None, laws: Sequence[str]) -> dict[str, str]:
    """Parameter file of each of the ``laws``."""
    path = Path(output or "none")
    several = {law: str(path.with_name(f"{path.stem}_{law}{path.suffix}")) for law in laws}
    return {} if output is None else several if len(laws) > 1 else {laws[0]: output}


def _yaml(arguments: argparse.Namespace, values: Values, one: "Tuned") -> str:
    from valve_control.design.tuning import tuner, verification

    reached = verification.as_dict(one.chosen.verified)
    about = [
        "valve-control " + shlex.join(arguments.line),
        f"On {reached['valves']} valves that the search did not see: e_rms "
        f"{reached['e_rms']['median']:.4g} V (median), {reached['e_rms']['p95']:.4g} V (95 %), "
        f"c_u {reached['c_u']:.3f}.",
    ]
    return ros_file.as_yaml({"/**/controller": tuner.parameters_of(one.law, values, one.chosen)}, about)


def _print(found: "Mapping[str, Tuned]") -> None:
    from valve_control.control.linear import margins
    from valve_control.design.tuning import checks, limits, verification

    print(
        f"{'law':12}{'e_rms [V]':>12}{'95 % [V]':>12}{'c_u':>8}"
        f"{'gain [dB]':>11}{'phase [deg]':>13}{'delay [ms]':>12}{'overshoot':>11}{'settled':>10}"
    )
    reached = {name: verification.as_dict(one.chosen.verified) for name, one in found.items()}
    for name, one in found.items():
        row, verified = reached[name], one.chosen.verified
        worst = margins.worst(verified.margins)
        numbers = (f"{row['e_rms'][part]:12.4f}" for part in ("median", "p95"))
        settled = f"> {1e3 * checks.HELD:g}" if math.isinf(verified.settling) else ""
        print(
            f"{name:12}{''.join(numbers)}{row['c_u']:8.3f}{worst.gain_db[0]:11.3g}"
            f"{worst.phase_deg[0]:13.3g}{1e3 * worst.delay_s[0]:12.3g}"
            f"{100.0 * verified.overshoot:9.2g} %{settled or f'{1e3 * verified.settling:.3g}':>7} ms"
            + ("" if one.chosen.holds else "  not accepted")
        )
    valves = next(iter(reached.values()))["valves"]
    print(f"on {valves} valves that the search did not see; margins: the least in the box")
    for name, one in found.items():
        print("\n".join(limits.as_text(one.limits, f"sets of gains of {name}")))
