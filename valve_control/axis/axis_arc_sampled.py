# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the adaptive robust control of ``axis_arc.py`` sample by sample, on what the sensors of an axis show.

The law wants the velocity, which no sensor shows: an observer of position, velocity and the acceleration that
the estimates do not explain makes it from the position's readings and the load force of both pressures. No
pressure is differentiated. docs/explanation/axis_arc.md derives it.
"""

import math
from typing import NamedTuple

from valve_control.axis import axis, axis_arc
from valve_control.axis.axis_arc import Measured, Model, Theta
from valve_control.axis.axis_pid import SpoolReference
from valve_control.axis.course import Goal
from valve_control.axis.machine import Reading
from valve_control.parameter import Parameter, ParameterError, Table, Values, number

NAME = "axis_arc"
NEEDS_PRESSURES = True
FASTEST = 0.5  # -  largest rate times sample period


class Params(NamedTuple):
    """The law, its observer and where its estimates begin, at one sample period."""

    law: axis_arc.Params
    begin: Theta
    smoothing: float  # -  share of a new pressure in the filtered one
    by_position: float  # -  share of the observer's error that goes to the position
    by_velocity: float  # 1/s  the same to the velocity
    by_acceleration: float  # 1/s²  the same to the acceleration
    lead: float  # s  from a command to the opening that it makes


class State(NamedTuple):
    """Estimates, observer, and what was wanted at the sample before."""

    theta: Theta
    samples: float  # periods from the last reading to the next; 0.0: there has been none
    position: float  # m
    velocity: float  # m/s
    unexplained: float  # m/s²  acceleration that the estimates do not explain
    pressure_a: float  # Pa  filtered
    pressure_b: float  # Pa
    acceleration: float  # m/s²  of the goal at the last reading


class Terms(NamedTuple):
    """What the upper level computed at this sample."""

    error: float  # m  goal less reading
    velocity: float  # m/s  of the axis, observed
    spool: float  # V
    z2: float  # m/s
    z3: float  # N
    unexplained: float  # m/s²


AT_REST = Terms(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def initial(p: Params) -> State:
    """Before the first reading."""
    return State(p.begin, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def estimates(s: State) -> dict[str, float]:
    """What has been learnt of the axis, by name with unit."""
    t = s.theta
    mass = 1.0 / t.mobility
    return {
        "mass_kg": mass,
        "damping_Ns_m": mass * t.damping,
        "coulomb_N": mass * t.friction,
        "force_N": mass * t.force,
        "bulk_modulus_Pa": t.bulk,
    }


def load_force(m: Model, pressure_a: float, pressure_b: float) -> float:
    """Force [N] of both pressures on the piston, positive: out."""
    return pressure_a * m.area_a - pressure_b * m.area_b


def explained(law: axis_arc.Params, t: Theta, velocity: float, force: float) -> float:
    """Acceleration [m/s²] by the estimates ``t`` under a load ``force`` [N]."""
    sign = math.tanh(velocity / law.friction_velocity)
    return t.mobility * force - t.damping * velocity - t.friction * sign + t.force


def observed(p: Params, s: State, reading: Reading) -> State:
    """State that has taken in a ``reading``; with the first one the axis is at rest there."""
    if s.samples == 0.0:
        a, b = reading.pressure_a, reading.pressure_b
        return State(s.theta, 1.0, reading.position, 0.0, 0.0, a, b, s.acceleration)
    m = p.law.model
    a = s.pressure_a + p.smoothing * (reading.pressure_a - s.pressure_a)
    b = s.pressure_b + p.smoothing * (reading.pressure_b - s.pressure_b)
    force = 0.5 * (load_force(m, s.pressure_a, s.pressure_b) + load_force(m, a, b))
    position, velocity = predicted(p, s, force)
    off = reading.position - position
    return State(
        s.theta,
        1.0,
        position + p.by_position * off,
        velocity + p.by_velocity * off,
        s.unexplained + p.by_acceleration * off,
        a,
        b,
        s.acceleration,
    )


def predicted(p: Params, s: State, force: float) -> tuple[float, float]:
    """Position [m] and velocity [m/s] one period after ``s``, under a load ``force`` [N] over it."""
    period = p.law.period
    acceleration = explained(p.law, s.theta, s.velocity, force) + s.unexplained
    position = s.position + period * (s.velocity + 0.5 * period * acceleration)
    return position, s.velocity + period * acceleration


def missed(p: Params, s: State) -> State:
    """State after a sample without a reading: the observed motion goes on, under the pressures of before."""
    if s.samples == 0.0:
        return s
    position, velocity = predicted(p, s, load_force(p.law.model, s.pressure_a, s.pressure_b))
    return s._replace(samples=s.samples + 1.0, position=position, velocity=velocity)


def ahead(lead: float, goal: Goal, jerk: float) -> Goal:
    """The goal a ``lead`` [s] later, with its ``jerk`` [m/s³]."""
    acceleration = goal.acceleration + lead * jerk
    velocity = goal.velocity + lead * (goal.acceleration + 0.5 * lead * jerk)
    position = goal.position + lead * (goal.velocity + 0.5 * lead * (goal.acceleration + lead * jerk / 3.0))
    return Goal(position, velocity, acceleration)


def step(p: Params, s: State, goal: Goal, reading: Reading) -> tuple[float, State, Terms]:
    """Compute one sample; returns the spool command [V], the next state and the terms."""
    periods = max(1.0, s.samples)  # since the goal last moved
    s = observed(p, s, reading)
    jerk = (goal.acceleration - s.acceleration) / (periods * p.law.period)
    force = load_force(p.law.model, s.pressure_a, s.pressure_b)
    acceleration = explained(p.law, s.theta, s.velocity, force) + s.unexplained
    velocity = s.velocity + p.lead * acceleration
    position = s.position + p.lead * (s.velocity + 0.5 * p.lead * acceleration)
    x = Measured(position, velocity, s.pressure_a, s.pressure_b)
    command, theta, found = axis_arc.step(p.law, s.theta, ahead(p.lead, goal, jerk), jerk, x)
    terms = Terms(goal.position - reading.position, s.velocity, command, found.z2, found.z3, s.unexplained)
    _, samples, position, velocity, unexplained, a, b, _ = s
    s = State(theta, samples, position, velocity, unexplained, a, b, goal.acceleration)
    return command, s, terms


def motion(p: Params, s: State, goal: Goal, jerk: float, terms: Terms) -> SpoolReference:
    """Where the spool is to be now, with the course's derivatives; ``s``, ``terms``: after the step.

    At constant velocity the opening is h·v/q (docs/explanation/axis_arc.md): course's acceleration and jerk
    times that. What the errors add has no derivative worth the name. The command is that of the lead later;
    the course's part of it is taken back, as with these derivatives the valve's law makes up for its own lag.
    """
    m, law = p.law.model, p.law
    x = Measured(s.position, s.velocity, s.pressure_a, s.pressure_b)
    opening = axis_arc.stiffness(m, s.position) / axis_arc.openness(m, x, terms.spool > 0.0)
    slope = opening * (law.full_scale - law.overlap)
    jumping = law.overlap_zone + law.overlap
    if abs(terms.spool) < jumping:
        slope *= jumping / law.overlap_zone
    if abs(terms.spool) >= law.limit:
        slope = 0.0
    early = p.lead * (goal.acceleration + 0.5 * p.lead * jerk)  # m/s
    return SpoolReference(terms.spool - slope * early, slope * goal.acceleration, slope * jerk)


PARAMETERS: Table = (
    Parameter("axis_arc.k1", 30.0, "1/s", "decay rate of the position error", 0.1, 1e4),
    Parameter("axis_arc.k2", 20.0, "1/s", "decay rate of the velocity error", 0.1, 1e4),
    Parameter("axis_arc.k3", 10.0, "1/s", "decay rate of the load force error", 0.1, 1e4),
    Parameter("axis_arc.coupling", 0.0, "1/s", "coupling of velocity and force error; 0: natural", 0.0, 1e4),
    Parameter(
        "axis_arc.learning", 1.0, "m/s", "velocity error that weighs as an estimate's range", 1e-6, 1e6
    ),
    Parameter(
        "axis_arc.uncertainty", 0.4, "-", "share by which each estimate may leave its initial value", 0.0, 0.9
    ),
    Parameter(
        "axis_arc.force_range", 1000.0, "N", "largest change of the estimated constant force", 0.0, 1e8
    ),
    Parameter("axis_arc.mass", 0.0, "kg", "initial estimate of the mass; 0: that of the machine", 0.0, 1e7),
    Parameter("axis_arc.bulk_modulus", 0.0, "Pa", "initial bulk modulus; 0: that of the machine", 0.0, 1e11),
    Parameter("axis_arc.friction_velocity", 0.02, "m/s", "width of the turn of friction", 1e-5, 10.0),
    Parameter(
        "axis_arc.overlap_zone", 0.2, "V", "command beyond the overlap of whole compensation", 1e-6, 100.0
    ),
    Parameter("axis_arc.observer", 150.0, "1/s", "the three equal poles of the velocity observer", 1.0, 1e5),
    Parameter(
        "axis_arc.lead", 0.002, "s", "delay from a command to its opening, by valve and sampling", 0.0, 0.1
    ),
    Parameter("axis_arc.pressure_cutoff", 200.0, "Hz", "cut-off of the low-pass of both pressures", 1.0, 1e5),
)


def model_of(plant: axis.Params, supply: float) -> Model:
    """What is known of the axis ``plant`` at a ``supply`` pressure [Pa]."""
    c, k = plant.cylinder, plant.coefficients
    return Model(
        c.area_a, c.area_b, c.stroke, c.dead_a, c.dead_b, supply, plant.supply.tank,
        k.pa, k.pb, k.at, k.bt, plant.laminar,
    )  # fmt: skip


def _known(plant: axis.Params, mass: float, bulk: float) -> Theta:
    """Estimates of the axis ``plant`` with another ``mass`` [kg] and ``bulk`` modulus [Pa]."""
    c, load = plant.cylinder, plant.load
    resting = load.force - plant.supply.tank * (c.area_a - c.area_b)
    return Theta(1.0 / mass, load.damping / mass, load.coulomb / mass, resting / mass, bulk)


def build(values: Values, plant: axis.Params, supply: float) -> Params:
    """Params from checked values, for the axis that is known as ``plant`` at a ``supply`` pressure [Pa].

    Raises ParameterError.
    """

    def of(name: str) -> float:
        return number(values, f"{NAME}.{name}")

    period = number(values, "sample_period")
    limit, overlap = number(values, "spool_limit"), number(values, "overlap")
    if overlap >= plant.full_scale:
        raise ParameterError(
            f"overlap is {overlap:g} V, no less than spool.full_scale, {plant.full_scale:g} V"
        )
    mass = of("mass") or plant.load.mass
    begin = _known(plant, mass, of("bulk_modulus") or plant.bulk_modulus)
    model = model_of(plant, supply)
    squared = begin.bulk * begin.mobility * axis_arc.stiffness(model, 0.5 * model.stroke)
    coupling = of("coupling") or math.sqrt(squared)  # ω_h in the middle of the stroke
    rates = {"k1": of("k1"), "k2": of("k2"), "k3": of("k3"), "coupling": coupling, "observer": of("observer")}
    own = {f"{NAME}.{name}": rate for name, rate in rates.items()}
    for name, rate in {**own, "load.damping over the mass": begin.damping}.items():
        if rate * period > FASTEST:
            raise ParameterError(
                f"{name} is {rate:.4g} 1/s; with a sample period of {period:g} s it must be at most "
                f"{FASTEST / period:g} 1/s"
            )
    share = of("uncertainty")
    force = of("force_range") / mass
    low = Theta(*(value * (1.0 - share) for value in begin))._replace(force=begin.force - force)
    high = Theta(*(value * (1.0 + share) for value in begin))._replace(force=begin.force + force)
    gamma = Theta(*(((h - q) / of("learning")) ** 2 for q, h in zip(low, high, strict=True)))
    law = axis_arc.Params(
        **{name: of(name) for name in ("k1", "k2", "k3", "friction_velocity", "overlap_zone")},
        w3=1.0 / (mass * coupling) ** 2,
        gamma=gamma,
        low=low,
        high=high,
        full_scale=plant.full_scale,
        overlap=overlap,
        limit=limit,
        period=period,
        model=model,
    )
    z = math.exp(-of("observer") * period)
    return Params(
        law=law,
        begin=begin,
        smoothing=1.0 - math.exp(-2.0 * math.pi * of("pressure_cutoff") * period),
        by_position=1.0 - z * z * z,
        by_velocity=1.5 * (1.0 - z) * (1.0 - z) * (1.0 + z) / period,
        by_acceleration=(1.0 - z) * (1.0 - z) * (1.0 - z) / (period * period),
        lead=of("lead"),
    )
