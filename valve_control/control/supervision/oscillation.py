# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds a limit cycle in the voltage: cycles of even length and height that the command does not have.

A loop that is unstable grows until the amplifier limits it, or friction, or adaptation: it ends in a limit
cycle, whose voltage swings evenly, cycle after cycle. Noise swings unevenly, a transient shrinks, and what a
command brings about has the command's own frequency.

The voltage is cut into swings: a turn counts once the voltage has come back from it by ``amplitude``. A cycle
goes from maximum to maximum; it is like the ones before if its length is within LENGTH (and 1.5 periods) and
its height within HEIGHT of their running mean. Enough of them, long enough, are an oscillation, unless the
command turned (a sine), or set off (a staircase), about as often. A law that makes up for friction answers a
sine with a voltage that turns three times as often, exactly: its third harmonic is no oscillation either.
"""

from typing import NamedTuple

LENGTH = 0.25  # of the mean length of a cycle
HEIGHT = 0.3  # of the mean height of a cycle
WEIGHT = 0.25  # of the newest cycle in the means
CYCLES = 8.0  # in a row
LEAST = 0.3  # s that they last
SHARE = 0.25  # by which counts of command and voltage may differ where the one explains the other
HARMONIC = 0.05  # the same of the third harmonic, beside one and a half turns
COMMAND_TURN = 0.02  # V by which a command comes back from a turn


class Params(NamedTuple):
    """What counts as an oscillation."""

    amplitude: float  # V  least amplitude that is reported, 0.0: none
    period: float  # s  ΔT
    back: float = 0.0  # V  by which the voltage comes back from a turn, at least ``amplitude``


class State(NamedTuple):
    """The present swing, the cycles in a row that are alike, and what the command did meanwhile.

    ``moving`` stays a float: recorded snapshots (``~/memory``) have it as 1.0 or 0.0.
    """

    rising: float  # -  1.0 or -1.0
    extreme: float  # V  highest (lowest) voltage of this swing
    start: float  # V  where this swing began
    maximum_time: float  # s  when the voltage had come back from its last maximum
    fall: float  # V  height of the last swing down
    cycles: float  # -  in a row that are alike
    since: float  # s  when they began
    length: float  # s  mean length of a cycle
    height: float  # V  mean height of a cycle, peak to peak
    command: float  # V  at the sample before
    moving: float  # -  1.0: the command changed at the sample before
    command_rising: float  # -  1.0 or -1.0
    command_extreme: float  # V
    turns: float  # -  of the command since ``since``
    departures: float  # -  of the command, from rest, since ``since``


NOTHING = State(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def step(p: Params, s: State, time: float, voltage: float, command: float) -> State:
    """State after the sample at ``time`` [s] with ``voltage`` [V] and ``command`` [V]."""
    moving, turns, departures = s.moving, s.turns, s.departures
    command_rising, command_extreme = s.command_rising, s.command_extreme
    if command == s.command:
        moving = 0.0
    else:
        if moving == 0.0:
            moving = 1.0
            departures += 1.0
        beyond = command_rising * (command - command_extreme)
        if beyond > 0.0:
            command_extreme = command
        elif beyond < -COMMAND_TURN:
            command_rising, command_extreme = -command_rising, command
            turns += 1.0
    rising, extreme, start, maximum_time, fall = s.rising, s.extreme, s.start, s.maximum_time, s.fall
    cycles, since, length, height = s.cycles, s.since, s.length, s.height
    beyond = rising * (voltage - extreme)
    if beyond > 0.0:
        extreme = voltage
    elif beyond >= -(p.back if p.back > p.amplitude else p.amplitude):
        if command == s.command and moving == s.moving:
            return s
    else:
        if rising < 0.0:
            fall = start - extreme
        else:
            this_length = time - maximum_time
            this_height = 0.5 * (fall + extreme - start)
            maximum_time = time
            if (
                abs(this_length - length) <= LENGTH * length + 1.5 * p.period
                and abs(this_height - height) <= HEIGHT * height
                and this_height >= 2.0 * p.amplitude
            ):
                cycles += 1.0
                length += WEIGHT * (this_length - length)
                height += WEIGHT * (this_height - height)
            else:
                cycles, since, length, height = 1.0, maximum_time - this_length, this_length, this_height
                turns, departures = 0.0, 0.0
        rising, start, extreme = -rising, extreme, voltage
    return State(
        rising, extreme, start, maximum_time, fall, cycles, since, length, height,
        command, moving, command_rising, command_extreme, turns, departures,
    )  # fmt: skip


def sustained(s: State) -> bool:
    """Whether the cycles in a row are an oscillation that the command does not explain."""
    return s.cycles >= CYCLES and s.maximum_time - s.since >= LEAST and not explained(s)


def explained(s: State) -> bool:
    """Whether the command turned or set off about as often as the voltage, or turned a third as often."""
    turned = abs(s.turns - 2.0 * s.cycles) <= 2.0 * SHARE * s.cycles + 1.0
    if abs(3.0 * s.turns - 2.0 * s.cycles) <= 2.0 * HARMONIC * s.cycles + 4.5:
        turned = True
    set_off = abs(s.departures - s.cycles) <= SHARE * s.cycles + 1.0
    return turned or set_off


def frequency(s: State) -> float:
    """Frequency [Hz] of the cycles in a row, mean of all."""
    return s.cycles / (s.maximum_time - s.since)


def amplitude(s: State) -> float:
    """Amplitude [V] of the cycles in a row: half of peak to peak."""
    return 0.5 * s.height
