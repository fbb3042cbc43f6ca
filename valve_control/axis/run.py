# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs an axis through the compiled loop of ``closed_loop.py``, which leaves other threads free."""

import types
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.axis import axis, cascade, course, machine, upper
from valve_control.axis import axis_parameters as parameters
from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.control import closed_loop
from valve_control.control.analysis.indices import variation
from valve_control.control.commands.arrays import refuse_aliased
from valve_control.control.compiling import bind, compile_function
from valve_control.control.laws import command_lead, linearisation, reshaping
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.parameters import build
from valve_control.parameter import ParameterError, Values, defaults, number, word

LAST = 1.0  # s  the end of a run, within which the axis has settled
NUMBERS = 44  # that a run keeps of a sample: goal, noise, signals, pressures on their way


NOT_RESHAPED = reshaping.Params(1.0, 1.0, 1.0, 1.0, 1.0)  # of a law that takes a command as it is


class Setup(NamedTuple):
    """Everything that is simulated in a run, built and checked."""

    law: str
    cascade: cascade.Params
    machine: machine.Params
    begin: machine.State
    goals: Floats  # rows of Goal
    seed: int
    level: str  # the upper level, of upper.LEVELS


class Indices(NamedTuple):
    """Quality of a run, of the true position."""

    e_rms: float  # m
    e_max: float  # m
    e_end: float  # m  largest in the last second
    u_rms: float  # V
    chatter: float  # -  c_u (I5) of the voltage
    energy: float  # J  taken from the supply


class Run(NamedTuple):
    """One run with its signals."""

    time: Floats  # s
    signals: dict[str, Floats]  # by cascade.SIGNALS
    indices: Indices


def default_settings() -> dict[str, Values]:
    """Values of all parameters of an axis, by node."""
    return {node: defaults(table) for node, table in AXIS_NODES.items()}


def goals_of(values: Values, position: float) -> Floats:
    """Course from values of ``axis_controller``, for an axis at ``position`` [m]: rows of Goal.

    Raises ParameterError.
    """
    period, duration = number(values, "sample_period"), number(values, "duration")
    build.check_memory(duration / period, NUMBERS)
    centre, stroke = position + number(values, "offset"), number(values, "distance")
    if word(values, "course") == "sine":
        refuse_aliased(number(values, "frequency"), period)
        return course.sine(centre, stroke, number(values, "frequency"), period, duration)
    if word(values, "course") == "step":
        rows = np.zeros((max(1, round(duration / period)), 3))
        begin = round(number(values, "pause") / period)
        if begin >= len(rows):
            raise ParameterError(
                f"duration is {duration:g} s; the step comes after the pause of {number(values, 'pause'):g} s"
            )
        rows[:, 0] = centre
        rows[begin:, 0] = centre + stroke
        return rows
    limits = course.MotionLimits(
        number(values, "max_velocity"), number(values, "max_acceleration"), number(values, "max_jerk")
    )
    goals = [centre + stroke, centre] if values["back"] else [centre + stroke]
    return course.point_to_point(centre, goals, number(values, "pause"), limits, period, duration)


def setup(settings: dict[str, Values]) -> Setup:
    """Build what is simulated from checked values by node. Raises ParameterError."""
    at, upper_values, law_values = (
        settings[name] for name in ("axis_simulator", "axis_controller", "controller")
    )
    period = number(at, "sample_period")
    for node in ("axis_controller", "controller"):
        other = number(settings[node], "sample_period")
        if other != period:
            raise ParameterError(
                f"sample_period is {period:g} s for the axis and {other:g} s for {node}; they must be equal"
            )
    plant = parameters.machine_params(at, settings["valve_simulator"])
    begin = parameters.start(plant, at)
    goals = goals_of(upper_values, number(at, "start.position"))
    if np.min(goals[:, 0]) < 0.0 or np.max(goals[:, 0]) > plant.axis.cylinder.stroke:
        raise ParameterError(
            f"the course goes from {np.min(goals[:, 0]):g} m to {np.max(goals[:, 0]):g} m, beyond the stroke "
            f"of {plant.axis.cylinder.stroke:g} m"
        )
    law = word(law_values, "controller")
    law_params = build.law_params(law_values)
    reshaped = LAWS[law].reshapes(law_params)
    lead = command_lead.build(law_values, reshaped) or command_lead.Params(
        0.0, 0.0, 0.0, 1.0, 1.0, number(law_values, "command_limit"), period
    )
    return Setup(
        law=law,
        cascade=cascade.Params(
            parameters.upper_level(upper_values, plant.axis, at),
            lead,
            linearisation.behind(law_values, law_params),
            word(upper_values, "message") == "trajectory",
            reshaped,
            law_params.reshaping if reshaped else NOT_RESHAPED,
        ),
        machine=plant,
        begin=begin,
        goals=goals,
        seed=int(number(at, "seed")),
        level=word(upper_values, "upper_level"),
    )


@cache
def _loop(law: types.ModuleType, level: types.ModuleType, compiled: bool) -> Callable[..., Any]:
    steps = {"valve_law_step": law.step, "upper_step": level.step, "upper_motion": level.motion}
    if compiled:
        both = compile_function(cascade.step, {name: compile_function(f) for name, f in steps.items()})
    else:
        both = bind({"step": cascade.step}, steps)["step"]
    return closed_loop.build({**cascade.FUNCTIONS, "law_step": both}, compiled, nogil=True)


def indices_of(s: Setup, signals: Floats, compiled: bool = True) -> Indices:
    """Run ``s``; ``signals`` (n×11) receives what ``cascade.shown`` returns at each sample."""
    law, level = linearisation.module_of(LAWS[s.law].module, s.cascade.valve_law), upper.LEVELS[s.level]
    n = len(s.goals)
    noise = np.random.default_rng(s.seed).standard_normal((n, machine.NOISES))
    first = machine.read(s.machine, s.begin, noise[0])
    states = cascade.State(
        level.initial(s.cascade.upper),
        command_lead.initial(0.0),
        law.initial(s.cascade.valve_law, Start(first.spool, 0.0, first.spool, 0.0, 0.0)),
        float(s.goals[0, 2]),
    )
    period = s.machine.axis.period
    last = float(n - min(n, round(LAST / period)))
    end = _loop(law, level, compiled)(
        closed_loop.Parts(0.0, s.cascade, s.machine, cascade.Measured(s.machine, last)),
        closed_loop.Parts(0.0, states, machine.copied(s.begin), cascade.EMPTY),
        s.goals,
        noise,
        signals,
        np.zeros((0, 3)),
    )
    t = end.measure
    return Indices(
        e_rms=float(np.sqrt(t.squares / n)),
        e_max=t.peak,
        e_end=t.last,
        u_rms=float(np.sqrt(t.voltage_squares / n)),
        chatter=float(variation(t.voltage_steps, t.voltage_squares, n)),
        energy=t.energy,
    )


def simulate(s: Setup, compiled: bool = True) -> Run:
    """Run one axis; plain Python (not ``compiled``) gives the same bits."""
    n = len(s.goals)
    rows = np.zeros((n, len(cascade.SIGNALS)))
    indices = indices_of(s, rows, compiled)
    signals = dict(zip(cascade.SIGNALS, rows.T, strict=True))
    p = s.machine.axis
    state = zip(
        *(signals[name] for name in ("position", "pressure_a", "pressure_b", "pressure_supply")), strict=True
    )
    found = [axis.pressures(p, axis.State(x, 0.0, a, b, supply, 0.0, 0.0)) for x, a, b, supply in state]
    for name, values in zip(("pressure_a", "pressure_b", "pressure_supply"), np.array(found).T, strict=True):
        signals[name] = values
    return Run(np.arange(n, dtype=np.float64) * p.period, signals, indices)
