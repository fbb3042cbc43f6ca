# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the open-loop laws: pole-zero compensators (12), (13) or of any design, and the bare static gain.

A compensator runs as three second-order sections in transposed direct form II; a polynomial of fifth
order with its poles close to z = 1 would lose half its digits.
"""

from typing import NamedTuple

from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate


class Section(NamedTuple):
    """One second-order section, a0 = 1."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


class Memory(NamedTuple):
    """The two delay elements of one section."""

    w1: float
    w2: float


class Params(NamedTuple):
    """Three cascaded sections and the static gain of all of them."""

    first: Section
    second: Section
    third: Section
    static_gain: float  # V/V
    u_max: float  # V


class State(NamedTuple):
    """Memory of the three sections."""

    first: Memory
    second: Memory
    third: Memory


class Terms(NamedTuple):
    """What the law computed at this sample."""

    reference: float  # V  the command
    z1: float  # V  reading minus command; not fed back
    unsaturated_voltage: float  # V


PASS = Section(1.0, 0.0, 0.0, 0.0, 0.0)


def static_params(valve_gain: float, u_max: float) -> Params:
    """The open loop without compensator: command divided by the valve's static gain [V/V]."""
    return Params(PASS._replace(b0=1.0 / valve_gain), PASS, PASS, 1.0 / valve_gain, u_max)


def gain(g: Section) -> float:
    """Static gain of one section."""
    return (g.b0 + g.b1 + g.b2) / (1.0 + g.a1 + g.a2)


def settled(g: Section, value: float) -> Memory:
    """Memory of one section in the steady state of the input ``value``."""
    output = gain(g) * value
    w2 = g.b2 * value - g.a2 * output
    return Memory(g.b1 * value - g.a1 * output + w2, w2)


def initial(p: Params, start: Start) -> State:
    """Steady state of the command that would give ``start.voltage``."""
    value = start.voltage / p.static_gain
    first = settled(p.first, value)
    value *= gain(p.first)
    second = settled(p.second, value)
    value *= gain(p.second)
    return State(first, second, settled(p.third, value))


def run_section(g: Section, m: Memory, value: float) -> tuple[float, Memory]:
    """Output and next memory of one section."""
    output = g.b0 * value + m.w1
    return output, Memory(g.b1 * value - g.a1 * output + m.w2, g.b2 * value - g.a2 * output)


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """Compute one sample; returns the voltage [V] within ±u_max, the next state and the terms."""
    value, first = run_section(p.first, s.first, command)
    value, second = run_section(p.second, s.second, value)
    value, third = run_section(p.third, s.third, value)
    voltage = saturate(value + offset, p.u_max)
    return voltage, State(first, second, third), Terms(command, measurement - command, value)


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample without a reading: the sections take in the command all the same."""
    return step(p, s, command, measurement, 0.0)[1]


def steady_command(p: Params, start: Start) -> float:
    """Command [V] whose static response is the voltage of ``start``."""
    return start.voltage / p.static_gain
