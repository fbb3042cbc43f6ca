# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Puts the range of a parameter on the places of a slider, logarithmic where it spans decades."""

import math
from typing import NamedTuple

from valve_control.parameter import Parameter

STEPS = 1000  # places of a slider
DECADES = 2.0  # from which on a range that does not touch 0 gets a logarithmic slider
FAR = 1000.0  # end from which on a range that begins at 0 gets one too ...
LEAST = 1e-9  # ... which begins at this share of its end


class Scale(NamedTuple):
    """The places 0 to STEPS of a slider over a range of values.

    A logarithmic one begins at ``floor``; where the range begins at 0, place 0 is 0 all the same.
    """

    low: float
    high: float
    whole: bool = False  # whether its values are whole numbers
    floor: float = 0.0  # above 0: logarithmic from here on

    def place(self, value: float) -> int:
        """Nearest place of ``value``."""
        value = min(max(value, self.low), self.high)
        if self.floor == 0.0:
            return round((value - self.low) / (self.high - self.low) * STEPS)
        if value < self.floor:
            return 0
        return round(math.log(value / self.floor) / math.log(self.high / self.floor) * STEPS)

    def value(self, place: float) -> float:
        """Value at ``place``, rounded to what the slider can tell apart, and inside the range."""
        share = min(max(place / STEPS, 0.0), 1.0)
        if share == 0.0:
            value, digits = self.low, 17
        elif self.floor > 0.0:
            value, digits = self.floor * (self.high / self.floor) ** share, 4
        else:
            value, digits = self.low + share * (self.high - self.low), 6
        value = min(max(float(f"{value:.{digits}g}"), self.low), self.high)
        return round(value) if self.whole else value


def scale(parameter: Parameter) -> Scale | None:
    """Scale of a slider for ``parameter``, None if it has no finite range."""
    low, high, whole = parameter.low, parameter.high, parameter.type_name == "integer"
    if not (whole or parameter.type_name == "double") or not math.isfinite(high - low) or low >= high:
        return None
    floor = 0.0
    if low > 0.0 and math.log10(high / low) >= DECADES:
        floor = low
    elif low == 0.0 and high >= FAR:
        floor = 1.0 if whole else high * LEAST
    return Scale(low, high, whole, floor)
