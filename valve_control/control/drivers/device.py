# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A driver in volts: scales, polarity limits of both sides; a device that is gone is opened anew."""

import math
import time
from typing import NamedTuple

from valve_control.control.drivers.driver import (
    Condition,
    Driver,
    DriverError,
    PolledDriver,
    Reading,
    patience,
)
from valve_control.control.drivers.scaling import Scale

RETRY = 1.0  # s between two attempts to open a device that is gone
LATCH = 1.0  # s for which lost readings stay reported


class Side(NamedTuple):
    """Reading or output: its scale, and the voltages that it may have."""

    scale: Scale
    low: float  # V
    high: float  # V


class Device:
    """Amplifier and LVDT behind a driver, in volts."""

    def __init__(self, driver: Driver, position: Side, voltage: Side, period: float) -> None:
        """``period``: sample period [s]."""
        self._driver = driver
        self._polled = driver if isinstance(driver, PolledDriver) else None
        self.position, self.voltage = position, voltage
        self._pause = patience(period)
        self._period = period
        self._gone: Condition | None = None
        self._fault: Condition | None = None  # keeps the output off after the device was opened anew
        self._retry_at = 0.0
        self._on = False
        self._beyond: float | None = None  # V, of the last reading if it is out of range
        self._broken = False  # the last reading has no live zero; the output is at 0 V
        self._lost_until = -math.inf
        self.readings = self.lost = self.late = self.reopened = 0

    def limit(self, position: Side, voltage: Side) -> None:
        """Use other limits."""
        self.position, self.voltage = position, voltage

    def open(self) -> None:
        """Open the device with its output off. Raises DriverError."""
        self._driver.open()

    def close(self) -> None:
        """Switch the output off and close the device."""
        self._driver.close()

    def enable(self, on: bool) -> None:
        """Switch the output stage on or off, at 0 V."""
        self._on = on
        self._fault = None
        if self._gone is None:
            try:
                self._driver.enable(on)
            except DriverError as error:
                self._lose(error)

    def write(self, voltage: float) -> None:
        """Give ``voltage`` [V] within the limits, 0 V if it is not finite, if the output is on."""
        side = self.voltage
        if self._on and self._gone is None and self._fault is None:
            finite = voltage if math.isfinite(voltage) and not self._broken else 0.0
            try:
                self._driver.write(side.scale.signal(max(side.low, min(side.high, finite))))
            except DriverError as error:
                self._lose(error)

    @property
    def polled(self) -> bool:
        """Whether ``poll`` never waits, so that devices can share a thread."""
        return self._polled is not None

    def due(self) -> float:
        """Time (`time.monotonic`) from which ``poll`` has something to do, besides bytes on ``fileno``."""
        if self._gone is not None:
            return self._retry_at
        return 0.0 if self._polled is None else self._polled.due()

    def fileno(self) -> int:
        """File that is readable when the device has sent something, -1 for none."""
        return -1 if self._polled is None or self._gone is not None else self._polled.fileno()

    def poll(self) -> Reading | None:
        """The next reading in volts if it is there; a driver that cannot be polled waits for it."""
        if self._polled is None:
            return self.read()
        if self._gone is not None:
            if time.monotonic() >= self._retry_at:
                self._reopen()
            return None
        tick = self._polled.due()
        try:
            reading = self._polled.poll()
        except DriverError as error:
            self._lose(error)
            return None
        if reading is None:
            return None
        self.late += 0.0 < tick < time.monotonic() - self._period
        return self._in_volts(reading)

    def read(self) -> Reading | None:
        """Wait for the next reading in volts, NaN if it is out of range; None if none came in time."""
        if self._gone is not None:
            if time.monotonic() >= self._retry_at:
                self._reopen()
            else:
                time.sleep(self._pause)
            return None
        try:
            reading = self._driver.read()
        except DriverError as error:
            self._lose(error)
            return None
        if reading is None:
            return None
        return self._in_volts(reading)

    def _in_volts(self, reading: Reading) -> Reading:
        self.readings += 1
        if reading.lost:
            self.lost += reading.lost
            self._lost_until = time.monotonic() + LATCH
        side = self.position
        volts = side.scale.volts(reading.signal)
        self._broken = reading.signal < side.scale.live_zero
        if side.low <= volts <= side.high:
            self._beyond = None
            return Reading(volts, reading.lost)
        self._beyond = None if math.isnan(volts) else volts
        return Reading(math.nan, reading.lost)

    def _lose(self, error: DriverError) -> None:
        """Close the device; a fault that had switched its output off outlasts the opening anew."""
        if self._gone is None and self._on:
            faults = ", ".join(c.name for c in self._driver.conditions() if c.level == "safe")
            if faults:
                text = (
                    f"the device was opened anew after {faults}: the output stays off until the node is "
                    "deactivated and activated"
                )
                self._fault = Condition("fault_before", "safe", text)
        self._driver.close()
        self._gone = Condition("device_gone", "safe", str(error))
        self._retry_at = time.monotonic() + RETRY

    def _reopen(self) -> None:
        """Open the device again."""
        try:
            self._driver.open()
            self._driver.enable(self._on and self._fault is None)
        except DriverError as error:
            self._lose(error)
        else:
            self._gone = None
            self.reopened += 1

    def conditions(self) -> tuple[Condition, ...]:
        """Faults that are there now, of the device and of its readings."""
        if self._gone is not None:
            return (self._gone,)
        found = self._driver.conditions()
        if self._fault is not None:
            found += (self._fault,)
        if self._broken:
            text = "the reading is below its live zero: the wire is broken, or the LVDT has no supply"
            found += (Condition("wire_broken", "safe", text),)
        elif self._beyond is not None:
            side = self.position
            text = f"the reading is {self._beyond:.4g} V, outside {side.low:g} to {side.high:g} V"
            found += (Condition("out_of_range", "degraded", text),)
        if time.monotonic() < self._lost_until:
            found += (Condition("readings_lost", "degraded", f"{self.lost} readings lost in all"),)
        return found
