# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Limits of the commands that the page lets one send."""

import math

from valve_control.control.commands.scenarios import Shape, stroke_time
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND
from valve_control.dashboard.valve import Valve
from valve_control.parameter import ParameterError, Value, Values, lookup, word


def largest(shape: Shape) -> float:
    """Largest command [V] of ``shape``, either way."""
    a, offset = shape.amplitude, shape.offset
    if shape.scenario == "constant":
        return abs(offset)
    if shape.scenario in ("step", "point_to_point"):
        return max(abs(offset), abs(offset + a))
    return abs(offset) + abs(a)


def fastest(shape: Shape) -> float:
    """Largest rate [V/s] of ``shape``; infinite for a step."""
    if shape.scenario == "constant" or shape.amplitude == 0.0:
        return 0.0
    if shape.scenario == "step":
        return math.inf
    if shape.scenario == "point_to_point":
        return stroke_time(abs(shape.amplitude), shape.max_velocity, shape.max_accel)[2]
    if shape.scenario == "triangle":
        return 4.0 * shape.frequency * abs(shape.amplitude)
    top = shape.frequency if shape.scenario == "sine" else max(shape.frequency, shape.end_frequency)
    return 2.0 * math.pi * top * abs(shape.amplitude)


def paced(valve: Valve) -> dict[str, Value]:
    """Parameters with which the command source keeps the pace of ``valve``, and begins when all hear it."""
    values = valve.controller.values if valve.controller is not None else {}
    return {
        "sample_period": values.get("sample_period", 0.001),
        "start": 0.0,
        "listeners": max(1, min(valve.listeners, int(lookup(COMMAND, "listeners").high))),
    }


def check(values: Values, limit: float, rate_limit: float) -> Shape:
    """Shape of the command source's ``values`` inside ± ``limit`` [V] and ``rate_limit`` [V/s].

    A step has no rate; its height is limited alone. Raises ParameterError.
    """
    shape = build.shape(values)
    if largest(shape) > limit:
        raise ParameterError(
            f"this {word(values, 'scenario')} reaches {largest(shape):g} V; the limit is {limit:g} V"
        )
    rate = fastest(shape)
    if math.isfinite(rate) and rate > rate_limit:
        raise ParameterError(
            f"this {word(values, 'scenario')} is as fast as {rate:.4g} V/s; the limit is {rate_limit:g} V/s"
        )
    return shape
