# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Says what is wanted of a commissioning, what it needs and gets of a running valve, and what ends it."""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.laws import linearisation
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import ParameterError, Value, Values, number, updated

SILENCE = 0.5  # s  of the command, after which the controller leads to neutral
BEYOND = 3  # readings in a row: a single one may be wrong
ROUNDING = 1e-9  # V
SWINGS = {"oscillation", "lvdt_hum"}
PUBLISHERS = {"command_publishers", "trajectory_publishers", "lvdt_publishers", "voltage_publishers"}
ENDS = {"saturation", *PUBLISHERS}
# With 0 V: readings stopped, were late or lost (a driver gives NaN for each), or the controller or its host
# stood still. What else is reported then may follow from it; if not, it comes again with the next try.
PAUSES = {"lvdt_silent", "lvdt_missing", "lvdt_period", "lvdt_bridged", "lvdt_not_finite", "stalled"}
Elapsed = Callable[[float], None]  # gets the time [s] of a course that is over
Progress = Callable[[float, float], None]  # sets of gains that are over, of about how many


class SafetyLimits(NamedTuple):
    """What is never exceeded while a valve is commissioned."""

    voltage: float  # V
    travel: float  # V  of the reading, to either side

    def applied(self, before: Values) -> Values:
        """What keeps them on a controller with the parameters ``before``, while the voltage is commanded."""
        timeout = number(before, "command_timeout")
        return {
            "controller": "open_loop",
            "open_loop.static_gain": 1.0,
            "u_max": self.voltage,
            "command_limit": self.voltage,
            "command_timeout": SILENCE if timeout == 0.0 else min(timeout, SILENCE),
            "command.bridge": 0.0,
            "command.lag": 0.0,
            "reshaping.lead": 0.0,
        }


class Plan(NamedTuple):
    """What is wanted of a commissioning."""

    limits: SafetyLimits
    law: str
    chatter: float  # limit of c_u
    budget: int  # sets of gains
    valves: int  # that are simulated in the search
    unseen: int  # on which gains are verified
    seed: int
    threads: int
    firm: bool = True  # False: where no gains keep the limit of c_u, the quieter ones are taken
    sensor_delay: float = 0.0  # s  what of the dead time is the sensor's
    gives_way: bool = False  # whether searches run only while no other wants the core


def check(plan: Plan, values: Values) -> None:
    """Raise ParameterError unless ``plan`` fits a controller with these ``values``."""
    u_max = number(values, "u_max")
    most = min(number(values, name) for name in ("lvdt.limit", "command_limit"))
    if not 0.1 <= plan.limits.voltage <= u_max:
        raise ParameterError(
            f"--max-voltage is {plan.limits.voltage:g} V; it must lie between 0.1 V and u_max, {u_max:g} V"
        )
    if not 0.2 <= plan.limits.travel <= most:
        raise ParameterError(
            f"--travel is {plan.limits.travel:g} V; it must lie between 0.2 V and the smaller of lvdt.limit "
            f"and command_limit, {most:g} V"
        )
    if values["lockstep"]:
        raise ParameterError("the controller runs in lockstep; a valve is commissioned on the wall clock")
    if linearisation.is_on(values):
        raise ParameterError(
            "linearisation.enabled is true; a valve is commissioned with its own static curve: set it to "
            "false, and to true again with the new gains"
        )
    if not LAWS[plan.law].free:
        raise ParameterError(f"{plan.law} has no gains to choose; there is nothing to tune")
    updated(CONTROLLER, values, plan.limits.applied(values))


class Instant(NamedTuple):
    """What a course knows when it gives its next command."""

    time: float  # s  since its beginning, by the numbers of the readings
    reading: float  # V


class Point(NamedTuple):
    """A point of a trajectory."""

    position: float  # V
    velocity: float  # V/s
    acceleration: float  # V/s²


Course = Generator[float | Point, Instant, None]  # commands [V] or points, one for each reading
Mark = Callable[[int, float], None]  # gets a stretch of a course, and the time [s] at which it begins


class Record(NamedTuple):
    """Readings since a course began, one entry a sample period, and the voltage that acted after each."""

    period: float  # s
    reading: Floats  # V  NaN: lost or late
    voltage: Floats  # V  mean until the next reading
    command: Floats  # V  in force when the voltage was given
    begins: tuple[int, ...] = (0,)  # samples at which a part begins, with a spool at rest
    latency: Floats = np.empty(0)  # s  from each reading that was answered to its voltage
    late: npt.NDArray[np.bool_] = np.empty(0, dtype=np.bool_)  # voltage or command is old; empty: nowhere

    def part(self, first: int, end: int) -> "Record":
        """Samples ``first`` to before ``end``, as one part."""
        parts = {name: getattr(self, name)[first:end] for name in ("reading", "voltage", "command", "late")}
        return self._replace(begins=(0,), **parts)

    def parts(self) -> "list[Record]":
        """Each part."""
        ends = (*self.begins[1:], len(self.reading))
        return [self.part(first, end) for first, end in zip(self.begins, ends, strict=True)]

    @staticmethod
    def joined(parts: "Sequence[Record]") -> "Record":
        """One record of several, whose parts stay apart."""
        if len(parts) == 1:
            return parts[0]
        begins, count = [], 0
        for part in parts:
            begins += [count + begin for begin in part.begins]
            count += len(part.reading)
        reading, voltage, command, latency, late = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("reading", "voltage", "command", "latency", "late")
        )
        return Record(parts[0].period, reading, voltage, command, tuple(begins), latency, late)


class Diagnosis(NamedTuple):
    """What a controller says of itself."""

    safe: bool  # whether it gives 0 V for a reason
    active: bool
    conditions: frozenset[str]
    text: str  # for the user


class Fault(RuntimeError):
    """Ends a commissioning at once; the message is one clause for the user."""


class Pause(Fault):
    """Something stood still, so that the controller gave 0 V; ``record``: of the course until then."""

    def __init__(self, text: str, record: Record | None = None) -> None:
        super().__init__(text)
        self.record = record


class Swings(Fault):
    """The loop of controller and valve swings."""


class Bench(Protocol):
    """A running controller with its valve."""

    @property
    def active(self) -> bool:
        """Whether the controller works. Raises Fault."""

    def values(self) -> Values:
        """All parameters of the controller. Raises Fault."""

    def apply(self, changes: Mapping[str, Value]) -> None:
        """Set all ``changes`` or none. Raises Fault if they are refused."""

    def on(self) -> None:
        """Let the controller work, if it does not. Raises Fault if it refuses."""

    def drive(self, course: Course, limits: SafetyLimits, elapsed: Elapsed) -> Record:
        """Give the commands of ``course`` until it ends. Raises Fault at a fault or beyond ``limits``.

        Raises Pause with the record until then.
        """

    def watch(self, limits: SafetyLimits) -> None:
        """Look at what has come meanwhile. Raises Fault as ``drive`` does."""

    def off(self) -> None:
        """Give 0 V at once, and go on so. Raises Fault if nobody answers."""


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
            raise Pause("the readings are not finite")
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
