# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Judges every reading, voltage and diagnosis of a valve that is commissioned."""

import math

from valve_control.design.commissioning.bench import Fault, SafetyLimits, Swings

BEYOND = 3  # readings in a row: a single one may be wrong
ROUNDING = 1e-9  # V
SWINGS = "oscillates"
# Words of a warning that ends it.
ENDS = ("saturated for", "publishers on", "inactive", "unconfigured")


class Watch:
    """Raises Fault at the first message that a commissioning must not go on with."""

    def __init__(self, limits: SafetyLimits) -> None:
        self._limits = limits
        self._beyond = 0

    def reading(self, value: float) -> None:
        """Take in one reading [V]."""
        self._beyond = self._beyond + 1 if not abs(value) <= self._limits.travel else 0
        if self._beyond < BEYOND:
            return
        if not math.isfinite(value):
            raise Fault("the readings are not finite")
        raise Fault(f"the reading is {value:.3g} V, beyond the travel of ±{self._limits.travel:g} V")

    def voltage(self, value: float) -> None:
        """Take in one voltage [V]."""
        if not math.isfinite(value) or abs(value) > self._limits.voltage + ROUNDING:
            raise Fault(f"the voltage is {value:.4g} V, beyond the limit of ±{self._limits.voltage:g} V")

    def diagnosis(self, error: bool, text: str) -> None:
        """Take in what the controller says of itself; ``error``: it gives 0 V."""
        if error or any(word in text for word in ENDS):
            raise Fault(f"the controller says: {text}")
        if SWINGS in text:
            raise Swings(f"the controller says: {text}")
