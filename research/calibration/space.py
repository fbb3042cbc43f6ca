# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters that a calibration may choose, each with its plausible range."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from valve_control.arrays import Floats
from valve_control.control.laws.registry import ADAPTIVE
from valve_control.control.parameters.table import NODES
from valve_control.parameter import Values, numbers, updated

Settings = dict[str, Values]  # by node


class Target(NamedTuple):
    """A parameter that receives the value of a free quantity."""

    node: str
    parameter: str
    entry: int = -1  # of a parameter that is a list
    factor: float = 1.0


class Dimension(NamedTuple):
    """One free quantity with its range."""

    name: str
    targets: tuple[Target, ...]
    low: float
    high: float
    logarithmic: bool
    unit: str
    reason: str  # for the range

    def from_unit(self, share: float) -> float:
        """Value at ``share`` of the range, 0 to 1."""
        if self.logarithmic:
            return self.low * math.exp(share * math.log(self.high / self.low))
        return self.low + share * (self.high - self.low)

    def to_unit(self, value: float) -> float:
        """Share of the range at which ``value`` lies, 0 or 1 for one outside of it."""
        value = min(max(value, self.low), self.high)
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


def _valve(
    name: str, low: float, high: float, unit: str, reason: str, logarithmic: bool = False
) -> Dimension:
    return Dimension(name, (Target("valve_simulator", name),), low, high, logarithmic, unit, reason)


def _command(name: str, low: float, high: float, unit: str, reason: str) -> Dimension:
    return Dimension(name, (Target("command_source", name),), low, high, False, unit, reason)


def _bound(end: str, entry: int, theta: str, low: float, high: float, unit: str, reason: str) -> Dimension:
    """One bound of θ as a quantity, the same for both laws that adapt."""
    targets = tuple(Target("controller", f"{law}.theta_{end}", entry) for law in ADAPTIVE)
    return Dimension(f"theta_{end} {theta}", targets, low, high, False, unit, reason)


def _law(name: str, low: float, high: float, unit: str, reason: str) -> Dimension:
    return Dimension(name, (Target("controller", name),), low, high, True, unit, reason)


# The command's speed and acceleration, the gains, the reshaping and θ(0) are the paper's and stay.
DIMENSIONS = (
    _valve("gain_scale", 0.8, 1.4, "-", "identified from small signals; a larger stroke may differ"),
    _valve("flow_force", -0.5, 0.5, "V/V", "closes; below 0 a softer spring; up to 0.4 of it"),
    _valve("disturbance.offset", -1.0, 1.0, "V", "centre of spring and amplifier: up to 10 % of u_max"),
    _valve("friction.coulomb", 0.1, 2.5, "V", "up to a quarter of u_max", True),
    _valve("friction.static_ratio", 1.0, 3.0, "-", "lubricated steel on steel"),
    _valve("friction.stribeck_velocity", 0.003, 10.0, "V/s", "below the command's 8 V/s", True),
    _valve("friction.presliding", 0.003, 0.6, "V", "micrometres up to 6 % of the stroke", True),
    _valve("lvdt.noise", 0.001, 0.020, "V", "0.01 to 0.2 % of 10 V", True),
    _valve("lvdt.resolution", 0.0003, 0.010, "V", "16 to 11 bits of ±10 V", True),
    _valve("lvdt.delay", 0.0, 0.002, "s", "demodulation and low-pass of the LVDT"),
    _command("amplitude", 1.5, 4.5, "V", "Fig. 5's stroke is not printed"),
    _command("cycle", 2.0, 12.0, "s", "Fig. 5's time axis is not printed"),
    _command("offset", -0.3, 0.3, "V", "where the command begins; the valve begins at 0 V"),
    _bound("min", 0, "a1", 1.0, 19.9, "1/s", "below θ1(0) = 20; positive, the valve is damped"),
    _bound("min", 1, "a0", 100.0, 1199.0, "1/s²", "below θ2(0) = 1200; positive, the valve has a spring"),
    _bound("min", 2, "b0", 600.0, 1199.0, "1/s²", "below θ3(0) = 1200, down to half of it"),
    Dimension(
        "theta_max b0·dn",
        tuple(
            Target("controller", f"{law}.theta_{end}", 3, sign)
            for law in ADAPTIVE
            for end, sign in (("min", -1.0), ("max", 1.0))
        ),
        100.0,
        6000.0,
        True,
        "V/s²",
        "±: 0.08 to 5 V at the input",
    ),
    _law("oarc.z2_weight", 1.0, 1e7, "1/s²", "1 is the print, which chatters at 1 ms (reference/errata.md)"),
    _law("arc.velocity_cutoff", 30.0, 480.0, "Hz", "'backward difference plus low pass'; not printed"),
    _law("pid.derivative_cutoff", 30.0, 480.0, "Hz", "not printed"),
)


def values_at(dimensions: Sequence[Dimension], point: Floats) -> dict[str, float]:
    """Value of each dimension at ``point`` of the unit cube."""
    return {d.name: d.from_unit(float(share)) for d, share in zip(dimensions, point, strict=True)}


def changed(base: Settings, dimensions: Sequence[Dimension], values: Mapping[str, float]) -> Settings:
    """``base`` with the free quantities at ``values``. Raises ParameterError."""
    changes: dict[str, Values] = {node: {} for node in base}
    for dimension in dimensions:
        for target in dimension.targets:
            node, name = target.node, target.parameter
            value = target.factor * values[dimension.name]
            if target.entry < 0:
                changes[node][name] = value
            else:
                items = numbers({**base[node], **changes[node]}, name)
                changes[node][name] = [*items[: target.entry], value, *items[target.entry + 1 :]]
    return {node: updated(NODES[node], base[node], changes[node]) for node in base}
