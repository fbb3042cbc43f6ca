# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Says what a commissioning needs of a running valve, and what it gets from it."""

from collections.abc import Callable, Generator, Mapping
from typing import NamedTuple, Protocol

from valve_control.arrays import Floats
from valve_control.parameter import Value, Values

Told = Callable[[float], None]  # s of a course that are over
Progress = Callable[
    [float, float], None
]  # fits, simulations or sets of gains that are over, of about how many


class SafetyLimits(NamedTuple):
    """What is never exceeded while a valve is commissioned."""

    voltage: float  # V
    travel: float  # V  of the reading, to either side


class Seen(NamedTuple):
    """What a course knows when it gives its next command."""

    time: float  # s  since its beginning, by the numbers of the readings
    reading: float  # V


Course = Generator[float, Seen, None]  # commands [V], one for each reading


class Record(NamedTuple):
    """Readings since a course began, one entry a sample period, and the voltage that answered each."""

    period: float  # s
    reading: Floats  # V  NaN: lost
    voltage: Floats  # V
    command: Floats  # V  in force when the voltage was given


class Fault(RuntimeError):
    """Ends a commissioning at once; the message is one clause for the user."""


class Swings(Fault):
    """The loop of controller and valve swings."""


class Bench(Protocol):
    """A running controller with its valve."""

    def values(self) -> Values:
        """All parameters of the controller. Raises Fault."""

    def apply(self, changes: Mapping[str, Value]) -> None:
        """Set all ``changes`` or none. Raises Fault if they are refused."""

    def on(self) -> None:
        """Let the controller work, if it does not. Raises Fault if it refuses."""

    def drive(self, course: Course, limits: SafetyLimits, told: Told) -> Record:
        """Give the commands of ``course`` until it ends. Raises Fault at a fault or beyond ``limits``."""

    def watch(self, limits: SafetyLimits) -> None:
        """Look at what has come meanwhile. Raises Fault as ``drive`` does."""

    def off(self) -> None:
        """Give 0 V at once, and go on so. Raises Fault if nobody answers."""
