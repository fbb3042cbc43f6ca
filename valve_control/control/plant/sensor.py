# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A sensor of a simulated valve or axis, each in its own unit (V for the LVDT): parameters and reading.

The dead time is that of ``valve.delayed``, which the history of a plant's motion needs.
"""

import math
from typing import NamedTuple

from valve_control.parameter import Parameter, Table, Values, number

PARAMETERS: Table = (
    Parameter("lvdt.noise", 0.0, "V", "standard deviation of the reading", 0.0, 10.0),
    Parameter("lvdt.resolution", 0.0, "V", "quantisation step of the reading; 0: none", 0.0, 10.0),
    Parameter("lvdt.bias", 0.0, "V", "constant error of the reading", -10.0, 10.0),
    Parameter("lvdt.delay", 0.0, "s", "dead time of the reading", 0.0, 1.0),
)


class Lvdt(NamedTuple):
    """A sensor; the LVDT's unit is V, that of an axis's sensor is the unit of what it reads."""

    noise: float  # V  standard deviation
    resolution: float  # V  quantisation step, 0: none
    bias: float  # V
    delay: float  # periods


IDEAL = Lvdt(0.0, 0.0, 0.0, 0.0)


def build(values: Values, name: str = "lvdt") -> Lvdt:
    """Sensor from the parameters ``name``.… of a simulator's values; without ``name``.bias it has none."""
    return Lvdt(
        noise=number(values, f"{name}.noise"),
        resolution=number(values, f"{name}.resolution"),
        bias=number(values, f"{name}.bias") if f"{name}.bias" in values else 0.0,
        delay=number(values, f"{name}.delay") / number(values, "sample_period"),
    )


def reading(lvdt: Lvdt, position: float, noise: float) -> float:
    """Reading of a sensor at ``position``, [V] for the LVDT; ``noise`` is a standard normal number."""
    shown = position + lvdt.bias + lvdt.noise * noise
    if lvdt.resolution > 0.0:
        shown = lvdt.resolution * math.floor(shown / lvdt.resolution + 0.5)
    return shown
