# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Takes a request to tune laws, makes the problems of search and verification of it, and carries it out."""

from collections.abc import Callable, Container, Sequence
from typing import Any, NamedTuple

from valve_control.arrays import Floats
from valve_control.control.laws import linearisation, reshaping
from valve_control.control.laws.free import entries_of
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS, LEFT_OUT
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import registry, transfer_functions
from valve_control.control.simulation import offline
from valve_control.control.simulation.robustness import Quantity, Settings
from valve_control.design.tuning import box, tuner
from valve_control.design.tuning.trial import Problem, TuningMotion
from valve_control.design.tuning.tuner import Tuned
from valve_control.parameter import ParameterError, Values, defaults, number, updated

SHORTEST = 1.0  # s  of a motion
STRAIGHT = (
    "the simulated valve is a linear model, which stands for the valve and the inverse of its static curve "
    "together; the search has linearisation.enabled false"
)


class Task(NamedTuple):
    """Laws to tune, the problems of their search and verification, and sentences about what was chosen."""

    laws: Sequence[Law]
    seen: Problem  # by the search
    unseen: Problem  # other valves, for verification
    notes: list[str]


def laws_of(names: str) -> list[Law]:
    """Laws of a list with commas, or all. Raises ParameterError."""
    asked = list(dict.fromkeys(name.strip() for name in names.split(",")))
    if asked == ["all"]:
        return [law for law in LAWS.values() if law.free]
    for name in asked:
        if name in LEFT_OUT:
            raise ParameterError(LEFT_OUT[name])
        if name not in LAWS:
            raise ParameterError(
                f"--controller {names}: there is no law '{name}'; there are {', '.join(LAWS)}, and all"
            )
        if not LAWS[name].free:
            raise ParameterError(f"{name} has no gains to choose; there is nothing to tune")
    return [LAWS[name] for name in asked]


def check_free(names: Sequence[str], laws: Sequence[Law]) -> None:
    """Raise ParameterError for one of the parameters ``names`` that the search of all ``laws`` chooses."""
    searched = [
        {name for free in law.free for name, index in entries_of(free) if index is None} for law in laws
    ]
    for name in names:
        if all(name in free for free in searched):
            raise ParameterError(f"the search chooses {name}; leave --set {name} out")


def motion_of(name: str, wanted: Floats, settings: Settings) -> TuningMotion:
    """The motion ``wanted`` [V], which gains can be tuned on. Raises ParameterError for another one."""
    seconds = len(wanted) * number(settings["command_source"], "sample_period")
    if seconds < SHORTEST:
        raise ParameterError(
            f"the command {name} lasts {seconds:g} s; to tune on it, it must last at least {SHORTEST:g} s"
        )
    if float(wanted.max() - wanted.min()) == 0.0:
        raise ParameterError(f"the command {name} does not move; there is nothing to tune on")
    box.check_reach(settings["valve_simulator"], float(wanted[abs(wanted).argmax()]), name)
    return TuningMotion(name, wanted)


def task_of(
    laws: Sequence[Law],
    settings: Settings,
    chosen: Container[str],
    quantities: Sequence[Quantity],
    valves: int,
    unseen: int,
    seed: int,
    **asked: Any,
) -> Task:
    """The task of tuning ``laws`` on so many ``valves``, verified on as many ``unseen`` ones.

    ``chosen``: names of the controller's parameters that somebody has chosen. ``quantities`` vary from valve
    to valve. ``asked``: other fields of the Problem. Raises ParameterError.
    """
    plant = settings["valve_simulator"]
    offline.check_agreement(settings["controller"], plant)
    if not quantities:
        raise ParameterError("every quantity of the box is fixed; there is no spread to tune for")
    values, notes = _controller(laws, settings, chosen, quantities)
    scale = transfer_functions.scale_of(build.valve_model(plant))
    problems = box.problems(
        {**settings, "controller": values}, quantities, valves, unseen, seed, scale=scale, **asked
    )
    return Task(laws, *problems, notes)


def _controller(
    laws: Sequence[Law], settings: Settings, chosen: Container[str], quantities: Sequence[Quantity]
) -> tuple[Values, list[str]]:
    """The controller's values before the search: what the valve says of them, unless it was chosen."""
    plant, values, notes = settings["valve_simulator"], settings["controller"], list[str]()
    if registry.chosen(plant).name == "linear" and linearisation.is_on(values):
        values = {**values, "linearisation.enabled": False}
        notes.append(STRAIGHT)
    for law in laws:
        values, note = box.with_model(law, {**settings, "controller": values}, chosen)
        notes.append(note)
        values, note = box.with_dead_time(law, {**settings, "controller": values}, quantities)
        notes.append(note)
    if "reshaping.form" not in chosen:  # a reference that brakes in time
        values = updated(CONTROLLER, values, {"reshaping.form": "braking"})
    limits = reshaping.limits(build.valve_model(plant), number(values, "u_max"))
    usual = defaults(reshaping.PARAMETERS)
    if limits and not any(name in chosen or values[name] != usual[name] for name in limits):
        accel, rate = limits.values()
        text = f"the reference is limited to {accel} V/s² and {rate} V/s, the most by (6), (7) of the paper"
        notes.append(f"{text}; --set reshaping.max_accel and reshaping.max_rate change them")
        values = updated(CONTROLLER, values, limits)
    return values, [note for note in notes if note]


def budgets(task: Task, budget: int) -> list[int]:
    """Sets of gains of each law, with ``budget`` for each of its variants."""
    return [budget * len(tuner.variants(law, task.seen.values)) for law in task.laws]


def search(
    task: Task, chatter: float, budget: int, threads: int, progress: Callable[[int, str], None]
) -> tuple[dict[str, Tuned], dict[str, str]]:
    """Results of all laws of a ``task`` by their names, and for each law without gains a sentence.

    ``chatter``: the limit that is asked for. ``progress`` gets the sets of gains tried so far, and the law.
    Raises ParameterError if the only law has no gains that can be used.
    """
    tuned: dict[str, Tuned] = {}
    missing: dict[str, str] = {}
    before, seed = 0, task.seen.seed
    for law, whole in zip(task.laws, budgets(task, budget), strict=True):

        def done(sets: int, law: Law = law, before: int = before) -> None:
            progress(before + sets, law.name)

        try:
            tuned[law.name] = tuner.tuned(
                law, task.seen, task.unseen, chatter, budget, seed, done, threads, firm=False
            )
        except ParameterError as error:
            if len(task.laws) == 1:
                raise
            missing[law.name] = str(error)
        before += whole
    return tuned, missing
