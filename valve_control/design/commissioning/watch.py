# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Judges every reading, voltage and diagnosis of a valve that is commissioned."""

import math

from valve_control.design.commissioning.bench import Diagnosis, Fault, Pause, SafetyLimits, Swings

BEYOND = 3  # readings in a row: a single one may be wrong
ROUNDING = 1e-9  # V
SWINGS = {"oscillation", "lvdt_hum"}
PUBLISHERS = {"command_publishers", "trajectory_publishers", "lvdt_publishers", "voltage_publishers"}
ENDS = {"saturation", *PUBLISHERS}
# With 0 V: readings stopped or were late, or the controller or its host stood still. What else is reported
# then may follow from it. If it does not, it is there without a pause too, when the stretch is repeated.
PAUSES = {"lvdt_silent", "lvdt_missing", "lvdt_period", "stalled"}


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

    def diagnosis(self, diagnosis: Diagnosis) -> None:
        """Take in what the controller says of itself."""
        text = f"the controller says: {diagnosis.text}"
        if not diagnosis.active or diagnosis.conditions & ENDS:
            raise Fault(text)
        if diagnosis.safe:
            raise Pause(text) if diagnosis.conditions & PAUSES else Fault(text)
        if diagnosis.conditions & SWINGS:
            raise Swings(text)
