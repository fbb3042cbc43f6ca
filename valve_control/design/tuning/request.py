# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Takes a request to tune laws, makes the problems of search and verification of it, and carries it out."""

from collections.abc import Callable, Container, Mapping, Sequence
from typing import Any, NamedTuple

from valve_control.arrays import Floats
from valve_control.control.laws import linearisation, reshaping
from valve_control.control.laws.free import entries_of
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS, LEFT_OUT
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import models, registry
from valve_control.control.simulation import offline
from valve_control.control.simulation.delivery import Delivery
from valve_control.control.simulation.robustness import Quantity, Settings
from valve_control.design.tuning import box, tuner
from valve_control.design.tuning.trial import Problem, TuningLimits, TuningMotion
from valve_control.design.tuning.tuner import Aim, Tuned
from valve_control.parameter import ParameterError, Values, defaults, number, updated

SHORTEST = 1.0  # s  of a motion
STRAIGHT = (
    "the simulated valve is a linear model, which stands for the valve and the inverse of its static curve "
    "together; the search has linearisation.enabled false"
)


class Request(NamedTuple):
    """What is tuned on what, and how long."""

    laws: Sequence[Law]
    settings: Settings  # parameters by node
    chosen: Container[str]  # names of the controller's parameters that somebody has chosen
    motions: Sequence[TuningMotion]
    box: Sequence[Quantity]  # that vary from valve to valve
    limits: TuningLimits
    chatter: float | None  # limit that is asked for
    preview: bool  # whether the motions are known ahead
    delivery: Delivery | None  # of commands that are not
    recorded: bool  # whether the settings are those of a recording, with the model that each law had
    valves: int
    unseen: int
    budget: int  # sets of gains of each law in each of its variants
    seed: int


class Task(NamedTuple):
    """The problems of a request, and sentences about what was chosen for them."""

    request: Request
    seen: Problem  # by the search
    unseen: Problem  # other valves, for verification
    notes: list[str]

    @property
    def budgets(self) -> list[int]:
        """Sets of gains that each law has."""
        variants = [tuner.variants(law, self.seen.values) for law in self.request.laws]
        return [self.request.budget * len(several) for several in variants]


class Outcome(NamedTuple):
    """Results by law, and for the other laws a sentence."""

    tuned: dict[str, Tuned]
    missing: dict[str, str]


def laws_of(names: str) -> list[Law]:
    """Laws of a list with commas, or all. Raises ParameterError."""
    if names == "all":
        return [law for law in LAWS.values() if law.free]
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


def task_of(request: Request) -> Task:
    """The problems of a ``request``. Raises ParameterError."""
    plant = request.settings["valve_simulator"]
    offline.check_agreement(request.settings["controller"], plant)
    if not request.box:
        raise ParameterError("every quantity of the box is fixed; there is no spread to tune for")
    values, notes = _controller(request)
    settings = {**request.settings, "controller": values}
    other_seed = request.seed + box.UNSEEN_SEED
    study = box.study_of(settings, request.box, request.valves, request.seed)
    other = box.study_of(settings, request.box, request.unseen, other_seed)
    seen = Problem(
        values=values,
        motions=request.motions,
        plants=box.drawn(study),
        box=box.bounding(study),
        limits=request.limits,
        preview=request.preview,
        seed=request.seed,
        scale=models.scale_of(build.valve_model(plant)),
        delivery=request.delivery,
    )
    unseen = seen._replace(plants=box.drawn(other), box=box.bounding(other), seed=other_seed)
    return Task(request, seen, unseen, notes)


def _controller(request: Request) -> tuple[Values, list[str]]:
    """The controller's values before the search: what the valve says of them, unless it was chosen."""
    plant, values, notes = request.settings["valve_simulator"], request.settings["controller"], list[str]()
    if registry.chosen(plant).name == "linear" and linearisation.is_on(values):
        values = {**values, "linearisation.enabled": False}
        notes.append(STRAIGHT)
    for law in request.laws:
        settings = {**request.settings, "controller": values}
        if not request.recorded:
            values, note = box.with_model(law, settings, request.chosen)
            notes += [note] if note else []
            settings = {**settings, "controller": values}
        values, expected = box.with_dead_time(law, settings, request.box)
        if expected is not None:
            notes.append(
                f"{law.dead_time} {expected:g} s, the expected lvdt.delay; --set {law.dead_time}=… says "
                "otherwise"
            )
    if "reshaping.form" not in request.chosen:  # a reference that brakes in time
        values = updated(CONTROLLER, values, {"reshaping.form": "braking"})
    limits = reshaping.limits(build.valve_model(plant), number(values, "u_max"))
    usual = defaults(reshaping.PARAMETERS)
    if limits and not any(name in request.chosen or values[name] != usual[name] for name in limits):
        text = " and ".join(f"{name} {value}" for name, value in limits.items())
        notes.append(f"{text}, (6) and (7) of this valve; --set says otherwise")
        values = updated(CONTROLLER, values, limits)
    return values, notes


def search(task: Task, threads: int, told: Callable[[int, str], None]) -> Outcome:
    """Tune all laws of a ``task``. ``told`` gets the sets of gains tried so far, and the law.

    Raises ParameterError if the only law has no gains that can be used.
    """
    request, outcome, before = task.request, Outcome({}, {}), 0
    for law, budget in zip(request.laws, task.budgets, strict=True):

        def told_of(done: int, law: Law = law, before: int = before) -> None:
            told(before + done, law.name)

        aim = Aim(request.chatter, firm=False)
        try:
            outcome.tuned[law.name] = tuner.tuned(
                law, task.seen, task.unseen, aim, request.budget, request.seed, told_of, threads
            )
        except ParameterError as error:
            if len(request.laws) == 1:
                raise
            outcome.missing[law.name] = str(error)
        before += budget
    return outcome


def as_dict(outcome: Outcome, files: Mapping[str, str]) -> dict[str, Any]:
    """For JSON, with the written parameter ``files`` by law."""
    laws = {name: {**tuner.as_dict(one), "file": files.get(name)} for name, one in outcome.tuned.items()}
    return {"laws": laws, **({"missing": outcome.missing} if outcome.missing else {})}
