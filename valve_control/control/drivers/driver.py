# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The contract of a driver: what is written to a valve's amplifier, what is read of its LVDT, which faults.

A driver has one device. One thread calls it: ``open``, ``enable``, then ``write`` and ``read`` in turn,
``close``. It speaks in the device's own unit (`scaling.py` turns it into volts) and keeps the sample period.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

from valve_control.parameter import Table, Values

PACKAGE = "valve_control"
LEVELS = ("degraded", "safe")  # of a condition: it goes on with less; the output is off


def patience(period: float) -> float:
    """Longest wait [s] for a reading at a sample ``period`` [s]."""
    return min(0.1, max(0.005, 5.0 * period))


class DriverError(RuntimeError):
    """Says why the device cannot be reached; the message is one sentence for the user."""


class Reading(NamedTuple):
    """One sample of the device."""

    signal: float  # in the device's own unit; NaN: the device itself calls it invalid
    lost: int  # readings that were lost since the one before


class Condition(NamedTuple):
    """A fault that lasts, of the device or of its bus."""

    name: str  # one word in lower case with _, such as heartbeat_lost
    level: str  # one of LEVELS
    text: str  # one sentence for the user, without a full stop


class Driver(Protocol):
    """One device with one output and one input. Every method may raise DriverError if the device is gone.

    After a DriverError the device is closed, and later opened anew. Faults that pass are ``conditions``. If
    one of level safe is there at a DriverError, the output stays off afterwards until the user enables it.
    """

    def open(self) -> None:
        """Open the device for reading; its output stays off, and nothing is written to it.

        Imports of third parties belong here, not to the module.
        """

    def enable(self, on: bool) -> None:
        """Switch the output stage on or off, as far as the hardware can; either gives the signal of 0 V.

        Readings that wait when it is switched on are stale and dropped, those of the time before not lost.
        """

    def write(self, signal: float) -> None:
        """Hand over the output signal without waiting; it acts at once, or at the device's next cycle."""

    def read(self) -> Reading | None:
        """Wait for the next reading; None if none came in time.

        The driver keeps the sample period: a card with a clock of its own sends its readings by itself, a
        bus is polled at the ticks of an absolute clock. ``read`` waits for ``patience(period)`` at most,
        because signals and services wait with it.
        """

    def close(self) -> None:
        """Switch the output off if it is on, as far as the device is reached, and close. Raises nothing."""

    def conditions(self) -> tuple[Condition, ...]:
        """Faults that are there now, of different names; after each reading, so it may take microseconds."""


@runtime_checkable
class PolledDriver(Driver, Protocol):
    """A driver that never makes its thread wait, so that several devices can share one."""

    def poll(self) -> Reading | None:
        """The next reading if it is there, at once."""

    def due(self) -> float:
        """Time (`time.monotonic`) from which `poll` has a reading without a new byte, inf if never.

        Of a driver with an absolute clock it is the next tick, by which the device counts late readings.
        """

    def fileno(self) -> int:
        """File that is readable when the device has sent something, -1 for none."""


class Kind(NamedTuple):
    """A kind of driver: its name, parameters and maker. A plug-in names one of these."""

    name: str  # of the parameter `driver`, and before the dot of its own parameters
    text: str  # what it speaks to, in a few words
    parameters: Table
    make: Callable[[Values, float, float], Driver]
    """Driver from the parameters' values, sample period [s] and signal of 0 V. Raises ParameterError."""
    extra: str = ""  # extra of this package that brings its library, "" for none
    volts: str = "V"  # scale of its signals, unless the user says otherwise
    package: str = PACKAGE  # that brings it


def missing(library: str, kind: str, extra: str) -> DriverError:
    """The error of a driver whose library is not installed."""
    return DriverError(f"driver {kind} needs {library}; install it with pip install '{PACKAGE}[{extra}]'")
