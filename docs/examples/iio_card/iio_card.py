# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Driver of an analogue card under Linux's industrial I/O: files with counts of the LVDT and the output."""

from contextlib import suppress
from pathlib import Path

from valve_control.control.drivers.driver import DriverError, Kind, Reading
from valve_control.control.drivers.ticks import Ticks
from valve_control.parameter import Parameter


class Card:
    """A card that is polled at the ticks of the host's clock."""

    def __init__(self, values, period, off):
        folder = Path(values["iio.folder"])
        self.input, self.output = folder / values["iio.input"], folder / values["iio.output"]
        self.period, self.off, self.on = period, off, False

    def open(self):
        """Read once, to see whether the card is there."""
        self.ticks = Ticks(self.period)
        self.read()

    def enable(self, on):
        """Begin at 0 V, or end there; this card has no output stage to switch."""
        self.on, self.ticks = on, Ticks(self.period)
        self.write(self.off)

    def write(self, signal):
        """Give counts."""
        try:
            self.output.write_text(f"{round(signal)}\n")
        except OSError as error:
            raise DriverError(f"{self.output} is not written: {error.strerror}") from error

    def read(self):
        """Counts at the next tick, with the ticks that went by since the last."""
        lost = self.ticks.wait()
        try:
            return Reading(float(self.input.read_text()), lost)
        except (OSError, ValueError) as error:
            raise DriverError(f"{self.input} gives no number: {error}") from error

    def close(self):
        """Give 0 V, if the output was on."""
        if self.on:
            with suppress(DriverError):
                self.enable(False)

    def conditions(self):
        """The card tells none."""
        return ()


PARAMETERS = (
    Parameter("iio.folder", "/sys/bus/iio/devices/iio:device0", "", "folder of the card"),
    Parameter("iio.input", "in_voltage0_raw", "", "file of the LVDT's counts"),
    Parameter("iio.output", "out_voltage0_raw", "", "file of the output's counts"),
)
KIND = Kind("iio", "an analogue card of Linux's industrial I/O", PARAMETERS, Card, volts="*0.00030517578125")
