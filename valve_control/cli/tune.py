# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `tune`: the best gains of any law for a box of valves, verified."""

import argparse
import math
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from valve_control import outputs
from valve_control.cli.common import (
    Progress,
    bag_options,
    check_outputs,
    check_processes,
    check_search,
    cluster_option,
    deliver,
    fix_option,
    say,
    tell_notes,
    workers,
    write_json,
    wrote,
)
from valve_control.cli.simulate import (
    delivery_of,
    delivery_options,
    settings_of,
    setup_options,
)
from valve_control.cli.study import box_of
from valve_control.parameter import ParameterError, Values, defaults, number, word

if TYPE_CHECKING:
    from valve_control.control.analysis.indices import Indices
    from valve_control.control.plant.models import TransferFunction
    from valve_control.control.simulation.cluster import Cluster
    from valve_control.control.simulation.robustness import Quantity
    from valve_control.design.commissioning.recorded import RecordedValve
    from valve_control.design.tuning.kept import Kept
    from valve_control.design.tuning.search import Told
    from valve_control.design.tuning.trial import Problem, TuningLimits, TuningMotion
    from valve_control.design.tuning.tuner import Aim, Tuned
    from valve_control.recordings.recording import Aligned, ValveRecording

PID = "pid"  # that is tuned beside the others
LOUDER = 1.2  # times the chatter with commands in time, from which that with uneven ones is told
FAILED = 1  # exit status if gains of a law are not accepted


def add_commands(commands: Any) -> None:
    """Add tune to the command's sub-commands."""
    tune = commands.add_parser(
        "tune",
        parents=[setup_options(several=True), delivery_options()],
        help="search and verify the gains of laws for a valve and its spread",
        description="Search the gains of one or more laws. The objective is a small error of the true "
        "position at limited chatter, on valves drawn from the study's box around a valve. The sampled "
        "loop has to keep its margins all over the box. Gains are written only if they pass a "
        "verification with other valves, noise and commands. --seed is the seed of the search.",
    )
    tune.add_argument(
        "--controller", metavar="LAW,…", help="laws to tune, or all (default: that of the parameter files)"
    )
    group = tune.add_argument_group("from a recording of normal operation")
    group.add_argument(
        "--bag",
        metavar="BAG",
        help="tune for the recorded valve, controller and command; --params-file has the known data of "
        "the valve, and quantities that the recording does not determine keep their values",
    )
    bag_options(group)
    group = tune.add_argument_group("objective")
    group.add_argument(
        "--max-chatter",
        type=float,
        metavar="C_U",
        help="limit of the mean chatter; where no gains keep it, the quieter ones are taken",
    )
    group.add_argument(
        "--max-error",
        type=float,
        metavar="V",
        help="limit of the error, as near as gains come; the chatter is minimised",
    )
    group.add_argument("--error", choices=("rms", "max"), default="rms", help="error that is minimised (rms)")
    group.add_argument(
        "--preview", action="store_true", help="commands are known ahead (topic spool_trajectory)"
    )
    _limit_options(tune.add_argument_group("limits on every valve of the box"))
    _search_options(tune.add_argument_group("search"))
    output = tune.add_argument_group("output")
    output.add_argument(
        "--output", metavar="FILE", help="ROS 2 parameter file; with several laws NAME_LAW.yaml for each"
    )
    output.add_argument("--json", metavar="FILE", help="all results as JSON; - for standard output alone")
    output.add_argument("--html", metavar="FILE", help="report as one HTML page")
    tune.set_defaults(run=_tune)


def _limit(text: str) -> float | None:
    """A limit, or None for "none"."""
    return None if text == "none" else float(text)


def _limit_options(limits: Any) -> None:
    limits.description = "none switches a limit off."
    limits.add_argument(
        "--gain-margin", type=_limit, default=3.0, metavar="DB", help="least gain margin, up and down (3 dB)"
    )
    limits.add_argument(
        "--phase-margin", type=_limit, default=20.0, metavar="DEG", help="least phase margin (20 degrees)"
    )
    limits.add_argument(
        "--delay-margin", type=_limit, default=0.0005, metavar="S", help="least delay margin (0.0005 s)"
    )
    limits.add_argument(
        "--peak", type=_limit, default=12.0, metavar="DB", help="largest peak of the sensitivity (12 dB)"
    )
    limits.add_argument(
        "--swing",
        type=_limit,
        default=0.04,
        metavar="V",
        help="largest oscillation about rest that friction sustains in the loop, unless the valve alone "
        "oscillates as much (0.04 V)",
    )
    limits.add_argument(
        "--saturation",
        type=_limit,
        default=0.02,
        metavar="X",
        help="largest mean share of saturated samples (0.02)",
    )
    limits.add_argument(
        "--overshoot",
        type=_limit,
        default=5.0,
        metavar="%",
        help="largest overshoot of steps of the command, median of the valves; a result that "
        "misses it says so (5 percent)",
    )
    limits.add_argument(
        "--pause",
        type=_limit,
        default=0.01,
        metavar="S",
        help="longest pause of the command after which the reference has to return to the motion (0.01 s)",
    )


def _search_options(group: Any) -> None:
    group.add_argument(
        "--valves", type=int, default=8, metavar="N", help="number of valves in the search (8)"
    )
    group.add_argument(
        "--unseen", type=int, default=64, metavar="N", help="number of valves in the verification (64)"
    )
    fix_option(group)
    group.add_argument(
        "--budget",
        type=int,
        default=4000,
        metavar="N",
        help="number of sets of gains of each law, for the PID of each form (4000)",
    )
    group.add_argument("--alone", action="store_true", help="tune no PID beside the requested laws")
    group.add_argument(
        "--threads", type=int, default=os.cpu_count() or 1, metavar="N", help="number of threads (all cores)"
    )
    cluster_option(group)
    group.add_argument(
        "--folder",
        help="folder in which a stopped search is kept, to resume it (out/tune-…, one for each request)",
    )


def _asked(
    arguments: argparse.Namespace,
) -> tuple[list[str], str | None, dict[str, Values], "_Recorded | None"]:
    """Files of commands and names of laws, the settings without them, and the recording to tune on."""
    files, arguments.command = arguments.command or [], None
    names, arguments.controller = arguments.controller, None
    settings = settings_of(arguments)
    if arguments.bag is None:
        return files, names, settings, None
    arguments.command = files
    recorded = _recorded(arguments, settings)
    return files, names, recorded.settings, recorded


def _tune(arguments: argparse.Namespace) -> int:
    old: list[str] = []
    try:
        return _tuned(arguments, old)
    finally:
        for path in filter(os.path.isfile, old):
            print(f"{path} is from before and was not replaced", file=sys.stderr)


def _tuned(arguments: argparse.Namespace, old: list[str]) -> int:
    """Tune; ``old`` gets the names of results that this run has not written."""
    from valve_control.control.laws.registry import LAWS
    from valve_control.control.simulation.cluster import ClusterError
    from valve_control.design.tuning import tuner

    _check(arguments)
    files, names, settings, recorded = _asked(arguments)
    laws = _laws(names, word(settings["controller"], "controller"))
    _check_free(arguments.set, laws)
    paths = _paths(arguments.output, laws)
    arguments.command = files
    check_outputs(arguments, [*paths.values(), arguments.html])
    each = [arguments.output, *_paths(arguments.output, list(LAWS)).values(), arguments.html, arguments.json]
    old += dict.fromkeys(path for path in each if path is not None)
    asked = laws if PID in laws or arguments.alone else [*laws, PID]
    problem, unseen = _problems(arguments, settings, files, asked, recorded)
    counts = [len(tuner.variants(LAWS[name], problem.values)) for name in asked]
    seed, aim = _seed(arguments), _aim(arguments)
    found: dict[str, Tuned] = {}
    missing: dict[str, str] = {}
    with (
        workers(arguments) as cluster,
        _stoppable(arguments, problem, unseen, asked, cluster, arguments.budget * sum(counts)) as search,
    ):
        for name, count in zip(asked, counts, strict=True):
            try:
                found[name] = tuner.tuned(
                    LAWS[name], problem, unseen, aim, arguments.budget, seed, search.of(name), search.kept
                )
            except ParameterError as error:
                if isinstance(error, ClusterError) or (len(laws) == 1 and name in laws):
                    raise
                missing[name] = str(error)
                print(error, file=sys.stderr)
            search.over(count * arguments.budget)
    written = {name: path for name, path in paths.items() if name in found and found[name].chosen.holds}
    result = _result(found, missing, laws, written)
    if recorded is not None:
        result["recording"] = _on_recording(recorded, found, problem.values)
    for name, path in written.items():
        _save(path, name, problem.values, found[name], arguments)
        old.remove(path)
        wrote(arguments, path)
    for name, one in found.items():
        for reason in one.chosen.verified.reasons:
            print(f"{name}: not accepted, because {reason}", file=sys.stderr)
        for note in one.notes:
            print(f"{name}: {note}", file=sys.stderr)
    if arguments.json != "-":
        _print(found)
        if recorded is not None:
            _print_recording(result["recording"])
    if arguments.html is not None:
        from valve_control.design.tuning import tuning_report

        deliver(
            arguments,
            arguments.html,
            tuning_report.page(unseen, aim, found, missing, laws, written, _typed(arguments)),
        )
        old.remove(arguments.html)
    write_json(arguments, result)
    if arguments.json is not None:
        old.remove(arguments.json)
    search.kept.forget()
    return 0 if all(name in found and found[name].chosen.holds for name in laws) else FAILED


class _Search:
    """A search that can be stopped, and what it tells meanwhile."""

    def __init__(self, kept: "Kept", total: int) -> None:
        self.kept = kept
        self.done = 0  # sets of gains
        self._before = 0  # of the laws that are over
        self._total = total
        self._progress = Progress(total, "sets of gains")
        self._going_on = bool(kept.found)
        if not kept.found:
            self._progress(0)

    def of(self, law: str) -> "Told":
        """What the search of ``law`` tells its sets of gains to."""

        def told(done: int) -> None:
            self.done = self._before + done
            if self.kept.known:
                return
            if self._going_on:
                print(f"{self.done} of {self._total} sets of gains were tried already", file=sys.stderr)
            self._going_on = False
            self._progress(self.done, f" ({law})")

        return told

    def over(self, count: int) -> None:
        """The ``count`` sets of gains of a law are over."""
        self._before += count


@contextmanager
def _stoppable(
    arguments: argparse.Namespace,
    problem: "Problem",
    unseen: "Problem",
    asked: list[str],
    cluster: "Cluster | None",
    total: int,
) -> Iterator[_Search]:
    """The search that the options ask for, which goes on where it was if it was stopped before.

    Raises ParameterError for a folder that has another one.
    """
    from importlib.metadata import version

    from valve_control.control.compiling import sources_digest
    from valve_control.control.simulation.cluster import ClusterError
    from valve_control.design.tuning.kept import Kept, digest

    aim = _aim(arguments)
    request = {
        "laws": asked,
        "budget": arguments.budget,
        "seed": _seed(arguments),
        "max_chatter": aim.chatter,
        "max_error": aim.error,
        "seen": digest(problem),
        "unseen": digest(unseen),
        "sources": sources_digest(),
        "packages": {name: version(name) for name in ("numpy", "scipy", "numba", "cma")},
    }
    usual = Path("out", f"tune-{'-'.join(asked)}-{digest(request)[:8]}")
    folder = usual if arguments.folder is None else Path(arguments.folder)
    there = next((path for path in (folder, *folder.parents) if path.exists()), Path())
    writable = there.is_dir() and os.access(there, os.W_OK)
    if arguments.folder == "":
        raise ParameterError("--folder is empty; give the name of a folder")
    if not writable and arguments.folder is not None:
        raise ParameterError(f"--folder {folder} cannot be written: {there} is no folder, or read-only")
    if not writable:
        print(f"note: {there} cannot be written, so a search that is stopped is lost", file=sys.stderr)
    kept = Kept(folder if writable else None, request, cluster or arguments.threads)
    search = _Search(kept, total)
    try:
        yield search
    except (KeyboardInterrupt, ClusterError):
        if search.done and writable:
            try:
                kept.write()
                said = f"{search.done} of {total} sets of gains are in {folder}; the same command goes on"
            except OSError as error:
                said = f"the search could not be kept, {error}"
            print(f"stopped; {said}", file=sys.stderr)
        raise
    except ParameterError:
        kept.forget()
        raise


def _check(arguments: argparse.Namespace) -> None:
    from valve_control.design.tuning import pauses

    if arguments.bag is None:
        for name, value in (
            ("from", arguments.start),
            ("to", arguments.end),
            ("of", arguments.of),
            ("map", arguments.map or None),
            ("clock", arguments.clock),
        ):
            if value is not None:
                raise ParameterError(f"--{name} is for a recording; give --bag too")
    if arguments.output is None and arguments.json is None and arguments.html is None:
        raise ParameterError("tune without --output, --json or --html keeps no gains; give one of them")
    check_processes("threads", arguments.threads)
    check_search(_seed(arguments), arguments.valves, arguments.unseen, arguments.budget)
    if arguments.preview and (arguments.command_period, arguments.command_jitter) != (None, None):
        raise ParameterError(
            "--preview is for motions that are known ahead, so tune takes no --command-period and no "
            "--command-jitter with it"
        )
    if arguments.max_chatter is not None and arguments.max_error is not None:
        raise ParameterError("--max-chatter and --max-error contradict each other; give one of them")
    for name in ("max_chatter", "max_error", "peak", "swing"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < math.inf:
            raise ParameterError(f"--{name.replace('_', '-')} is {value:g}; it must be above 0, and finite")
    for name, most in (
        ("gain_margin", 60.0),
        ("phase_margin", 120.0),
        ("delay_margin", 1.0),
        ("saturation", 1.0),
        ("overshoot", 1000.0),
        ("pause", pauses.LONGEST),
    ):
        value = getattr(arguments, name)
        if value is not None and not 0.0 <= value <= most:
            raise ParameterError(
                f"--{name.replace('_', '-')} is {value:g}; it must lie between 0 and {most:g}"
            )


def _seed(arguments: argparse.Namespace) -> int:
    return 1 if arguments.seed is None else int(arguments.seed)


def _laws(names: str | None, usual: str) -> list[str]:
    """Laws that ``names`` asks for. Raises ParameterError."""
    from valve_control.control.laws.registry import LAWS, LEFT_OUT

    if names is None:
        return [usual]
    if names == "all":
        return [name for name, law in LAWS.items() if law.free]
    asked = list(dict.fromkeys(name.strip() for name in names.split(",")))
    if "all" in asked:
        raise ParameterError(f"--controller {names}: all stands alone, it means every law that has gains")
    for name in asked:
        if name in LEFT_OUT:
            raise ParameterError(LEFT_OUT[name])
        if name not in LAWS:
            raise ParameterError(
                f"--controller {names}: there is no law '{name}'; there are {', '.join(LAWS)}, and all"
            )
        if not LAWS[name].free:
            raise ParameterError(f"{name} has no gains to choose; there is nothing to tune")
    return asked


def _check_free(settings: Sequence[str], laws: list[str]) -> None:
    """Raise ParameterError for a --set of a number that the search chooses for each of ``laws``."""
    from valve_control.control.laws.free import entries_of
    from valve_control.control.laws.registry import LAWS

    chosen = [
        {name for free in LAWS[law].free for name, index in entries_of(free) if index is None} for law in laws
    ]
    for text in settings:
        name = text.partition("=")[0].strip()
        if all(name in names for names in chosen):
            raise ParameterError(f"the search chooses {name}; leave --set {name} out")


def _paths(output: str | None, laws: list[str]) -> dict[str, str]:
    """Parameter file of each law."""
    if output is None:
        return {}
    if len(laws) == 1:
        return {laws[0]: output}
    path = Path(output)
    return {name: str(path.with_name(f"{path.stem}_{name}{path.suffix}")) for name in laws}


def _aim(arguments: argparse.Namespace) -> "Aim":
    from valve_control.design.tuning.tuner import Aim

    return Aim(arguments.max_chatter, arguments.max_error, firm=False)


def _limits(arguments: argparse.Namespace) -> "TuningLimits":
    from valve_control.design.tuning.trial import TuningLimits

    def most(value: float | None) -> float:
        return math.inf if value is None else value

    return TuningLimits(
        arguments.gain_margin or 0.0,
        arguments.phase_margin or 0.0,
        arguments.delay_margin or 0.0,
        most(arguments.peak),
        most(arguments.swing),
        most(arguments.saturation),
        arguments.pause or 0.0,
        0.01 * most(arguments.overshoot),
    )


def _motions(
    arguments: argparse.Namespace, settings: dict[str, Values], files: list[str]
) -> list["TuningMotion"]:
    """The commands, each of at least one second. Raises ParameterError."""
    from valve_control.control.commands import arrays
    from valve_control.control.parameters import build
    from valve_control.design.tuning import box
    from valve_control.design.tuning.trial import TuningMotion

    if files and arguments.scenario is not None:
        raise ParameterError(
            f"--command {files[0]} and --scenario {arguments.scenario} contradict each other; "
            "give one of them"
        )
    source = settings["command_source"]
    motions = [TuningMotion(Path(file).name, arrays.read(file)) for file in files]
    if not files:
        motions = [TuningMotion(word(source, "scenario"), build.commands(source))]
    period = number(source, "sample_period")
    for motion in motions:
        if len(motion.wanted) * period < 1.0:
            raise ParameterError(
                f"the command {motion.name} lasts {len(motion.wanted) * period:g} s; to tune on it, it must "
                "last at least 1 s"
            )
        if float(motion.wanted.max() - motion.wanted.min()) == 0.0:
            raise ParameterError(f"the command {motion.name} does not move; there is nothing to tune on")
        most = motion.wanted[abs(motion.wanted).argmax()]
        box.check_reach(settings["valve_simulator"], float(most), motion.name)
    return motions


def _problems(
    arguments: argparse.Namespace,
    settings: dict[str, Values],
    files: list[str],
    laws: list[str],
    recorded: "_Recorded | None" = None,
) -> tuple["Problem", "Problem"]:
    """What the search sees, and what verification sees. Raises ParameterError."""
    from valve_control.control.laws.registry import LAWS
    from valve_control.control.parameters import build
    from valve_control.control.parameters import files as parameter_files
    from valve_control.control.plant import models
    from valve_control.control.simulation import offline
    from valve_control.design.tuning import box
    from valve_control.design.tuning.trial import Problem

    offline.check_agreement(settings["controller"], settings["valve_simulator"])
    settings = _straight(settings)
    quantities = box_of(arguments) if recorded is None else recorded.box
    if not quantities:
        raise ParameterError("every quantity of the box is fixed; there is no spread to tune for")
    motions = _motions(arguments, settings, files) if recorded is None else [recorded.motion]
    chosen = parameter_files.given(arguments.params_file, {}, arguments.set)["controller"]
    for law in map(LAWS.__getitem__, laws):
        if recorded is None:
            values, said = box.with_model(law, settings, chosen)
            tell_notes([said] if said else [])
            settings = {**settings, "controller": values}
        values, expected = box.with_dead_time(law, settings, quantities)
        if expected is not None:
            print(
                f"note: {law.dead_time} {expected:g} s, the expected lvdt.delay; "
                f"--set {law.dead_time}=… says otherwise",
                file=sys.stderr,
            )
        settings = {**settings, "controller": values}
    model = build.valve_model(settings["valve_simulator"])
    controller = _with_limits(_braking(settings["controller"], chosen), model, chosen)
    settings = {**settings, "controller": controller}
    seed = _seed(arguments)
    study = box.study_of(settings, quantities, arguments.valves, seed)
    other = box.study_of(settings, quantities, arguments.unseen, seed + box.UNSEEN_SEED)
    seen = Problem(
        settings["controller"],
        motions,
        box.drawn(study),
        box.bounding(study),
        _limits(arguments),
        arguments.preview,
        arguments.error == "max",
        seed,
        scale=models.scale_of(model),
        delivery=None if arguments.preview else delivery_of(arguments, settings["controller"]),
    )
    return seen, seen._replace(plants=box.drawn(other), box=box.bounding(other), seed=seed + box.UNSEEN_SEED)


def _straight(settings: dict[str, Values]) -> dict[str, Values]:
    """``settings`` without a curve where the simulated valve has none that it takes away."""
    from valve_control.control.laws import linearisation
    from valve_control.control.plant import registry

    if registry.chosen(settings["valve_simulator"]).name != "linear" or not linearisation.is_on(
        settings["controller"]
    ):
        return settings
    tell_notes(
        [
            "the simulated valve is a linear model, which stands for the valve and the inverse of its static "
            "curve together; the search has linearisation.enabled false"
        ]
    )
    return {**settings, "controller": {**settings["controller"], "linearisation.enabled": False}}


def _braking(values: Values, given: Values) -> Values:
    """The controller's ``values`` with a reference that brakes in time, unless a form was given."""
    from valve_control.control.parameters.table import CONTROLLER
    from valve_control.parameter import updated

    if "reshaping.form" in given or values["reshaping.form"] == "braking":
        return values
    return updated(CONTROLLER, values, {"reshaping.form": "braking"})


def _with_limits(values: Values, model: "TransferFunction", given: Values) -> Values:
    """The controller's ``values`` with (6) and (7) of the valve, unless limits were ``given``."""
    from valve_control.control.laws import reshaping
    from valve_control.control.parameters.table import CONTROLLER
    from valve_control.parameter import updated

    limits = reshaping.limits(model, number(values, "u_max"))
    usual = defaults(reshaping.PARAMETERS)
    if not limits or any(name in given or values[name] != usual[name] for name in limits):
        return values
    text = " and ".join(f"{name} {value}" for name, value in limits.items())
    print(f"note: {text}, (6) and (7) of this valve; --set says otherwise", file=sys.stderr)
    return updated(CONTROLLER, values, limits)


class _Recorded(NamedTuple):
    """What a recording of normal operation gives."""

    settings: dict[str, Values]
    box: list["Quantity"]
    motion: "TuningMotion"
    found: "RecordedValve"
    valve: "ValveRecording"
    signals: "Aligned"
    measured: "Indices"


def _refuse_beside_bag(arguments: argparse.Namespace) -> None:
    """Raise ParameterError for options that say what the bag says, and for a part of it without end."""
    named = ("command", "scenario", "valve", "sample_period", "duration", "command_period", "command_jitter")
    for name in named:
        if getattr(arguments, name) not in (None, []):
            raise ParameterError(f"tune --bag takes no --{name.replace('_', '-')}; the bag has its own")
    if arguments.start is not None and arguments.end is not None and arguments.end <= arguments.start:
        raise ParameterError(f"--to {arguments.end:g} lies not after --from {arguments.start:g}")


def _tell_learnt(arguments: argparse.Namespace, found: "RecordedValve", notes: Sequence[str]) -> None:
    """Print what a recording has told of the valve, and the ``notes`` on it."""
    for one in found.learnt:
        unit = "" if one.unit == "-" else f" {one.unit}"
        text = (
            f"{one.name}: {one.value:.4g} ± {one.bound:.2g}{unit}"
            if one.determined
            else f"{one.name}: not determined by this recording; stays {one.value:.4g}{unit}"
        )
        say(arguments, text + (" (times the known valve's)" if one.name in ("gain", "speed") else ""))
    for note in (*found.notes, *notes):
        print(f"note: {note}", file=sys.stderr)


def _controller_of(arguments: argparse.Namespace, valve: "ValveRecording", usual: Values) -> Values:
    """The controller's parameters as recorded; what the options say wins. ``usual``: where none are."""
    from valve_control.control.parameters import files
    from valve_control.control.parameters.table import CONTROLLER
    from valve_control.parameter import updated

    if valve.controller is None:
        return usual
    told = dict(valve.controller.initial)
    for change in valve.controller.changes:
        told.update(change.values)
    values, _ = valve.controller.table_values(told)
    return updated(CONTROLLER, values, files.given(arguments.params_file, {}, arguments.set)["controller"])


def _recorded(arguments: argparse.Namespace, settings: dict[str, Values]) -> _Recorded:
    """Valve, controller and command of a recording. Raises ParameterError and BagError."""
    import numpy as np

    from valve_control.control.analysis.indices import indices
    from valve_control.control.parameters.table import CONTROLLER
    from valve_control.design.commissioning import recorded as learning
    from valve_control.design.identification import recorded as tests
    from valve_control.design.tuning import box
    from valve_control.design.tuning.trial import TuningMotion
    from valve_control.parameter import updated
    from valve_control.recordings import recording
    from valve_control.recordings.bags.errors import BagError

    _refuse_beside_bag(arguments)
    loaded = recording.load(
        arguments.bag, arguments.map, arguments.start, arguments.end, clock=arguments.clock
    )
    if not loaded.valves:
        raise BagError(f"{arguments.bag} has no topic of a valve")
    valve = recording.chosen(arguments.bag, loaded.valves, arguments.of)
    if "spool_command" not in valve.signals or len(valve.signals["spool_command"].time) == 0:
        raise BagError(f"{valve.name} has no spool_command, so there is nothing to tune on")
    tested = tests.recorded(loaded, valve)
    usual = box_of(arguments)
    fixed = [form.name for form in learning.FORMS if form.name in arguments.fix]
    found = learning.learnt(tested, settings["valve_simulator"], fixed)
    controller = updated(
        CONTROLLER,
        _controller_of(arguments, valve, settings["controller"]),
        {"sample_period": tested.period, "u_max": number(found.values, "u_max")},
    )
    signals = recording.align(valve)
    known = np.isfinite(signals.command) & np.isfinite(signals.measurement) & np.isfinite(signals.voltage)
    measured = indices(
        np.where(known, signals.measurement - signals.command, 0.0),
        np.where(known, signals.voltage, 0.0),
        tested.period,
        known,
    )
    wanted = learning.motion(signals.command, tested.period, number(controller, "command_limit"))
    if float(wanted.max() - wanted.min()) == 0.0:
        raise ParameterError(f"{arguments.bag} has no excitation: its command does not move")
    name = Path(arguments.bag).name
    box.check_reach(found.values, float(wanted[abs(wanted).argmax()]), f"of {name}")
    _tell_learnt(arguments, found, tested.notes)
    source = {**settings["command_source"], "sample_period": tested.period}
    made = {**settings, "controller": controller, "valve_simulator": found.values, "command_source": source}
    return _Recorded(
        made, learning.box(found, usual), TuningMotion(name, wanted), found, valve, signals, measured
    )


def _on_recording(recorded: _Recorded, found: dict[str, "Tuned"], tuned: Values) -> dict[str, Any]:
    """What was measured, and what the gains of then and of now give on the recorded command, simulated.

    ``tuned``: the controller's values around which the gains were searched.
    """
    from valve_control.design.tuning import tuner
    from valve_control.recordings import what_if

    values = recorded.settings["controller"]

    def simulated(controller: Values) -> dict[str, float]:
        run = what_if.replay(recorded.valve, recorded.signals, controller, recorded.found.values).run
        return {**run.indices._asdict(), "true_e_rms": run.true_error["e_rms"]}

    return {
        "valve": {
            one.name: {
                "value": one.value,
                "bound": one.bound if one.determined else None,
                "determined": one.determined,
            }
            for one in recorded.found.learnt
        },
        "residual": recorded.found.residual,
        "measured": recorded.measured._asdict(),
        "simulated_as_it_was": simulated(values),
        "simulated_with": {
            name: simulated({**values, **tuner.parameters_of(name, tuned, one.chosen)})
            for name, one in found.items()
        },
    }


def _print_recording(about: dict[str, Any]) -> None:
    rows = {
        "measured": about["measured"],
        "simulated as it was": about["simulated_as_it_was"],
        **{f"simulated with new {name}": row for name, row in about["simulated_with"].items()},
    }
    print("on the recorded command:")
    for name, row in rows.items():
        errors = f"e_rms {1e3 * row['e_rms']:8.2f} mV   e_M {1e3 * row['e_M']:8.1f} mV"
        print(f"  {name:28} {errors}   c_u {row['c_u']:.3f}")


def _typed(arguments: argparse.Namespace) -> str:
    return "valve-control " + shlex.join(arguments.line)


def _save(path: str, name: str, values: Values, one: "Tuned", arguments: argparse.Namespace) -> None:
    from valve_control.control.parameters import files
    from valve_control.design.tuning import tuner, verification

    reached = verification.as_dict(one.chosen.verified)
    about = [
        _typed(arguments),
        f"On {reached['valves']} valves that the search did not see: e_rms "
        f"{reached['e_rms']['median']:.4g} V (median), {reached['e_rms']['p95']:.4g} V (95 %), "
        f"c_u {reached['c_u']:.3f}.",
    ]
    chosen = tuner.parameters_of(name, values, one.chosen)
    outputs.write(path, files.as_yaml({"/**/controller": chosen}, about))


def _result(
    found: dict[str, "Tuned"], missing: dict[str, str], laws: list[str], written: dict[str, str]
) -> dict[str, Any]:
    """For JSON; the PID that was not asked for stands beside the laws."""
    from valve_control.design.tuning import tuner

    made: dict[str, dict[str, Any]] = {}
    for name, one in found.items():
        made[name] = tuner.as_dict(one)
        made[name]["file"] = written.get(name)
    result: dict[str, Any] = {"laws": {name: made[name] for name in laws if name in made}}
    beside = {name: one for name, one in made.items() if name not in laws}
    if beside:
        result["beside"] = beside
    if missing:
        result["missing"] = missing
    return result


def _print(found: dict[str, "Tuned"]) -> None:
    from valve_control.control.linear import margins
    from valve_control.design.tuning import limits, overshoot, verification

    if not found:
        return
    print(
        f"{'law':12}{'e_rms [V]':>12}{'95 % [V]':>12}{'c_u':>8}"
        f"{'gain [dB]':>11}{'phase [deg]':>13}{'delay [ms]':>12}{'overshoot':>11}{'settled':>10}"
    )
    for name, one in found.items():
        reached = verification.as_dict(one.chosen.verified)
        worst = margins.worst(one.chosen.verified.margins)
        numbers = (f"{reached['e_rms'][part] or math.nan:12.4f}" for part in ("median", "p95"))
        print(
            f"{name:12}{''.join(numbers)}{reached['c_u'] or math.nan:8.3f}{worst.gain_db[0]:11.3g}"
            f"{worst.phase_deg[0]:13.3g}{1e3 * worst.delay_s[0]:12.3g}"
            f"{100.0 * one.chosen.verified.overshoot:9.2g} %"
            + (
                f"{1e3 * one.chosen.verified.settling:7.3g} ms"
                if math.isfinite(one.chosen.verified.settling)
                else f"{f'> {1e3 * overshoot.HELD:g}':>7} ms"
            )
            + ("" if one.chosen.holds else "  not accepted")
        )
    valves = verification.as_dict(next(iter(found.values())).chosen.verified)["valves"]
    print(f"on {valves} valves that the search did not see; margins: the least in the box")
    for name, one in found.items():
        reached = verification.as_dict(one.chosen.verified)
        uneven = reached["uneven_c_u"]
        if uneven is not None and uneven > LOUDER * (reached["c_u"] or 0.0):
            print(
                f"{name}: c_u {uneven:.2f} with commands that come early or late by {verification.UNEVEN:g} "
                "samples; --command-jitter tunes for such"
            )
    for name, one in found.items():
        print("\n".join(limits.as_text(one.limits, f"sets of gains of {name}")))
