# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Draws the valves of a box around a given one: those that are simulated, and those for the margins."""

import itertools
from collections.abc import Container, Sequence
from typing import Any

import numpy as np

from valve_control.control.laws.law import Law
from valve_control.control.linear import stability
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import transfer_functions
from valve_control.control.simulation import robustness
from valve_control.control.simulation.robustness import Quantity, Settings, Study
from valve_control.design.tuning.trial import Problem
from valve_control.parameter import ParameterError, Values, number, updated

SCATTERED = 32  # valves within the box for the margins, besides its corners
LINEAR = ("gain", "speed", "flow_force", "lvdt.delay")  # quantities on which the margins depend
FRICTION = "friction.coulomb"
UNSEEN_SEED = 1_000_003  # added to the seed for valves that the search does not see


def quantities(fixed: Sequence[str], chosen: Container[str], task: str) -> list[Quantity]:
    """The quantities that vary in a ``task``: those of the study that are not ``fixed``.

    ``chosen``: names of parameters that somebody has chosen. Raises ParameterError for one that varies.
    """
    names = [q.name for q in robustness.BOX]
    for name in fixed:
        if name not in names:
            raise ParameterError(f"--fix {name}: there is no such quantity; there are {', '.join(names)}")
    varied = [q for q in robustness.BOX if q.name not in fixed]
    for q in varied:
        if q.name in chosen:
            unit = "" if q.unit == "-" else f" {q.unit}"
            raise ParameterError(
                f"{task} varies {q.name} from {q.low:g} to {q.high:g}{unit}; leave --set {q.name} out, or "
                f'keep its value with --fix="{q.name}"'
            )
    return varied


def problems(
    settings: Settings, box: Sequence[Quantity], valves: int, unseen: int, seed: int, **asked: Any
) -> tuple[Problem, Problem]:
    """The problem of a search on so many ``valves`` of ``box`` around that of ``settings``; one ``unseen``.

    ``asked``: the other fields of the Problem. Raises ParameterError.
    """

    def problem(count: int, own: int) -> Problem:
        study = study_of(settings, box, count, own)
        return Problem(settings["controller"], plants=drawn(study), box=bounding(study), seed=own, **asked)

    return problem(valves, seed), problem(unseen, seed + UNSEEN_SEED)


def study_of(settings: Settings, box: Sequence[Quantity], valves: int, seed: int) -> Study:
    """The valves of ``box`` around that of ``settings``, at its own sample period."""
    return Study(settings, valves, seed, box, (number(settings["controller"], "sample_period"),))


def drawn(study: Study) -> list[Any]:
    """All valves of ``study``. Raises ParameterError."""
    points, periods = robustness.draw(study, 0, study.valves)
    return [
        build.valve_params(robustness.valve_of(study, i, point, float(period)))
        for i, (point, period) in enumerate(zip(points, periods, strict=True))
    ]


def bounding(study: Study) -> list[Any]:
    """Corners of the box, as far as margins depend on it, and SCATTERED within, behind the law's curve.

    The corners have the most friction of the box: with less of it swings are smaller. Raises ParameterError.
    """
    ends = (
        (q.low, q.high) if q.name in LINEAR else (q.high if q.name == FRICTION else 0.5 * (q.low + q.high),)
        for q in study.box
    )
    corners = [
        build.valve_params(robustness.valve_of(study, 0, np.array(point), study.periods[0]))
        for point in itertools.product(*ends)
    ]
    plants = [*corners, *drawn(study._replace(valves=SCATTERED))]
    controller = study.settings["controller"]
    return [seen for plant in plants for seen in stability.behind_curve(controller, plant)]


def with_dead_time(law: Law, settings: Settings, box: Sequence[Quantity]) -> tuple[Values, str]:
    """The controller's values with the dead time that ``law`` may expect, and a sentence about that.

    It is the middle of what the valves of ``box`` have, or that of the valve of ``settings``. The dead time
    before the coil of a solenoid valve is the law's ``actuator_delay``. The values stay if the law does not
    ask for it, has been told another than 0 (or one of the actuator), or cannot be built with it.
    """
    values, plant = settings["controller"], settings["valve_simulator"]
    actuator = f"{law.name}.actuator_delay"
    if not law.dead_time or any(values.get(name, 0.0) != 0.0 for name in (law.dead_time, actuator)):
        return values, ""
    ranges = {q.name: 0.5 * (q.low + q.high) for q in box}
    expected = ranges.get("lvdt.delay", number(plant, "lvdt.delay"))
    changes: dict[str, Any] = {law.dead_time: expected}
    if plant["valve"] == "solenoid" and actuator in values:
        changes[actuator] = number(plant, "solenoid.dead_time")
    try:
        changed = updated(CONTROLLER, values, changes)
        law.build(changed)
    except ParameterError:
        return values, ""
    note = f"{law.dead_time} is {expected:g} s, the expected lvdt.delay; --set {law.dead_time} changes it"
    return changed, note if expected else ""


def with_model(law: Law, settings: Settings, given: Container[str]) -> tuple[Values, str]:
    """The controller's values in which ``law`` has the valve's model, and a sentence about that.

    ``given``: names of parameters that somebody has chosen; a model among them stays. The sentence is ""
    where the law has no model of its own, or that of the valve.
    """
    values, plant = settings["controller"], settings["valve_simulator"]
    name = f"{law.name}.model"
    if values.get(name, plant["valve"]) == plant["valve"] or name in given:
        return values, ""
    changes: dict[str, Any] = {name: plant["valve"]}
    if plant["valve"] not in transfer_functions.MODELS or number(plant, "gain_scale") != 1.0:
        model = law.of_model(build.valve_model(plant), number(plant, "sample_period"))
        changes = {name: "custom"}
        changes.update({f"{law.name}.{part}": list(c) for part, c in model._asdict().items()})
        known = law.of_plant(values, plant)
        changes.update({name: value for name, value in known.items() if name not in given})
    try:
        changed = updated(CONTROLLER, values, changes)
        for variant in law.variants:
            law.build(updated(CONTROLLER, changed, variant))
    except ParameterError as error:
        return values, f"{name} stays {values[name]}, which is another valve than the one given: {error}"
    return changed, f"{name} is that of the valve, {changed[name]}; --set {name} changes it"


def check_reach(plant: Values, wanted: float, name: str) -> None:
    """Raise ParameterError for a motion to ``wanted`` [V] at which the valve itself would saturate always."""
    model = build.valve_model(plant)
    needed = abs(wanted) / abs(model.static_gain) if model.static_gain != 0.0 else np.inf
    most = number(plant, "u_max")
    if needed > most:
        raise ParameterError(
            f"the command {name} goes to {wanted:g} V, for which the valve needs {needed:.3g} V; u_max is "
            f"{most:g} V, so that it saturates with any gains"
        )
