# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Judges the sensors of an axis: finite, within the stroke, no faster than it can move; pressures too."""

import math
from typing import NamedTuple

SOUND = ""


class Params(NamedTuple):
    """What counts as a believable reading."""

    low: float  # m
    high: float  # m
    tolerance: float  # m  beyond the stroke, and of a step from one reading to the next
    max_speed: float  # m/s
    pressure_high: float  # Pa
    pressure_jump: float  # Pa  from one reading to the next
    hold_samples: int  # wrong readings in a row for which the last command holds


class State(NamedTuple):
    """What is remembered between two readings."""

    position: float | None  # m  the last one that was believed
    pressures: tuple[float, float] | None  # Pa  likewise
    age: float  # s  since then
    wrong: int  # readings in a row


UNKNOWN = State(None, None, 0.0, 0)


def position_fault(p: Params, s: State, position: float, elapsed: float) -> str:
    """What is wrong with a ``position`` [m] that came ``elapsed`` [s] after the last; SOUND if nothing."""
    if not math.isfinite(position):
        return f"position is {position}"
    if not p.low - p.tolerance <= position <= p.high + p.tolerance:
        return f"position is {position:.4g} m, outside the stroke from {p.low:g} m to {p.high:g} m"
    age = s.age + elapsed
    if s.position is not None and abs(position - s.position) > p.max_speed * age + p.tolerance:
        return f"position jumps by {position - s.position:.4g} m within {age:.3g} s"
    return SOUND


def pressure_fault(p: Params, s: State, pressures: tuple[float, float]) -> str:
    """What is wrong with the ``pressures`` [Pa] of both rooms, SOUND if nothing."""
    for name, i in (("a", 0), ("b", 1)):
        pressure = pressures[i]
        if not math.isfinite(pressure):
            return f"pressure {name} is {pressure}"
        if not -p.pressure_jump <= pressure <= p.pressure_high:
            limit = p.pressure_high if pressure > 0.0 else -p.pressure_jump
            return f"pressure {name} is {1e-5 * pressure:.4g} bar, beyond {1e-5 * limit:g} bar"
        if s.pressures is not None and abs(pressure - s.pressures[i]) > (1 + s.wrong) * p.pressure_jump:
            return f"pressure {name} jumps by {1e-5 * (pressure - s.pressures[i]):.4g} bar"
    return SOUND


def step(
    p: Params, s: State, position: float, pressures: tuple[float, float] | None, elapsed: float
) -> tuple[str, State]:
    """SOUND or what is wrong with a sample, ``elapsed`` [s] after the one before; ``pressures`` if needed."""
    fault = position_fault(p, s, position, elapsed)
    if not fault and pressures is not None:
        fault = pressure_fault(p, s, pressures)
    if fault:
        return fault, s._replace(age=s.age + elapsed, wrong=s.wrong + 1)
    return SOUND, State(position, pressures, 0.0, 0)
