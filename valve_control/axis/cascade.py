# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes one sample of the cascade: the upper level commands the spool, the valve's law moves it."""

from collections.abc import Callable
from typing import Any, NamedTuple

from valve_control.arrays import Floats
from valve_control.axis import axis, machine
from valve_control.axis.course import Goal
from valve_control.control.closed_loop import Sample
from valve_control.control.laws import command_lead, reshaping
from valve_control.control.plant.saturation import saturate

SIGNALS = (
    "goal",  # m
    "position",  # m
    "velocity",  # m/s
    "measured",  # m
    "spool_command",  # V
    "spool",  # V
    "voltage",  # V
    "pressure_a",  # Pa
    "pressure_b",  # Pa
    "pressure_supply",  # Pa
    "relief",  # m³/s/√Pa
)


class Params(NamedTuple):
    """Upper level, lead of the spool command, law of the valve."""

    upper: Any
    lead: command_lead.Params
    valve_law: Any
    trajectory: bool  # the command comes with its derivatives
    reshaped: bool  # which the valve's law reshapes by what follows
    reshaping: reshaping.Params


class State(NamedTuple):
    """States of the same."""

    upper: Any
    lead: command_lead.State
    valve_law: Any
    acceleration: float  # m/s²  of the goal at the sample before


class Tally(NamedTuple):
    """What is measured over a run."""

    samples: float
    squares: float  # m²  sum of the squared position errors
    peak: float  # m  largest position error
    last: float  # m  largest position error within the last part of the run
    voltage_squares: float  # V²
    voltage_steps: float  # V²  sum of the squared steps of the voltage
    voltage: float  # V  of the sample before
    energy: float  # J  taken from the supply


class Measured(NamedTuple):
    """What the measures need to know."""

    machine: machine.Params
    last_begin: float  # sample with which the last part of the run begins


def upper_step(p: Any, s: Any, goal: Goal, reading: machine.Reading) -> Any:
    """Placeholder for the step of the upper level; returns (spool command, state, terms)."""
    raise NotImplementedError


def upper_motion(p: Any, s: Any, goal: Goal, jerk: float, terms: Any) -> Any:
    """Placeholder for the upper level's spool command with its derivatives."""
    raise NotImplementedError


def valve_law_step(p: Any, s: Any, command: float, reading: float, offset: float) -> Any:
    """Placeholder for the step of the valve's law; returns (voltage, state, terms)."""
    raise NotImplementedError


def goal_given(params: float, state: float, given: Floats) -> tuple[Goal, float]:
    """Command source of a run whose course is known: ``given`` is its row of this sample."""
    return Goal(given[0], given[1], given[2]), state


def step(
    p: Params, s: State, goal: Goal, reading: machine.Reading, offset: float
) -> tuple[float, State, Any]:
    """Compute one sample of both levels; returns the voltage [V], the next state and the upper terms."""
    command, upper, terms = upper_step(p.upper, s.upper, goal, reading)
    if p.trajectory:
        jerk = (goal.acceleration - s.acceleration) / p.lead.period
        wanted = upper_motion(p.upper, upper, goal, jerk, terms)
        lead = s.lead
        led = saturate(wanted.position, p.lead.limit)
        if p.reshaped:
            moving = 1.0 if led == wanted.position else 0.0
            rate, change = moving * wanted.velocity, moving * wanted.acceleration
            led = reshaping.command_of(p.reshaping, led, rate, change)
    else:
        lead = command_lead.step(p.lead, s.lead, command)
        led = command_lead.led(p.lead, lead, command)
    voltage, law, _ = valve_law_step(p.valve_law, s.valve_law, led, reading.spool, offset)
    return voltage, State(upper, lead, law, goal.acceleration), terms


def measure(p: Measured, s: Tally, now: Sample, plant: machine.State) -> tuple[Tally, bool]:
    """Take in one sample; errors are those of the true position."""
    error = abs(now.command.position - plant.axis.x)
    pressures = axis.pressures(p.machine.axis, plant.axis)
    spool = plant.valve.x.x0 / p.machine.axis.full_scale
    q = axis.flows(p.machine.axis, plant.axis, pressures, spool)
    jump = now.voltage - s.voltage if s.samples > 0.0 else 0.0
    return (
        Tally(
            s.samples + 1.0,
            s.squares + error * error,
            max(s.peak, error),
            max(s.last, error) if s.samples >= p.last_begin else s.last,
            s.voltage_squares + now.voltage * now.voltage,
            s.voltage_steps + jump * jump,
            now.voltage,
            s.energy + pressures.supply * (q.pa + q.pb) * p.machine.axis.period,
        ),
        False,
    )


def shown(plant: machine.State, now: Sample) -> tuple[float, ...]:
    """States of the axis and what the sensors and the upper level say; SIGNALS are made from them."""
    a = plant.axis
    return (
        now.command.position,
        a.x,
        a.v,
        now.reading.position,
        now.terms.spool,
        plant.valve.x.x0,
        now.voltage,
        a.a,
        a.b,
        a.supply,
        a.relief,
    )


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "next_command": goal_given,
    "read": machine.read,
    "measured": measure,
    "plant_step": machine.step,
    "shown": shown,
}
EMPTY = Tally(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
