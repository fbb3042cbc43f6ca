# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Records all inputs and outputs of a supervisor, row by row, so that a run can be repeated bit for bit.

Topics do not tell which command was in force when a reading was answered, which readings never came, or when
parameters took effect; the journal does, since it is written where the supervisor is called.
"""

import math
import time
from array import array
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.state_snapshot import snapshot
from valve_control.control.supervision.supervisor import Supervisor, unused
from valve_control.parameter import Values

COLUMNS = ("time", "event", "command", "reading", "number", "elapsed", "voltage")
LONG = 10**16  # ns, 116 days, after which stamps count from another moment: their seconds have 2 ns
LATER = 1000.0  # s
HEAD = 5  # numbers before the rows: which journal, number of the first row, time 0; times in s and ns


class Event(IntEnum):
    """Kind of a row; a row's command, if it is not NaN, was taken before its event."""

    READING = 0  # answered with a voltage
    SILENCE = 1  # of the LVDT
    STALL = 2  # this process stood still; the reading, if there was one, was not used
    COMMAND = 3  # nothing but the command, NaN included; its stamp as `reading`, since as `number`
    PARAMETERS = 4  # new ones are in use, which the account before the next row tells
    START = 5  # from rest
    STOP = 6  # with 0 V
    RESET = 7
    COMMAND_GONE = 8  # the upper level left
    COMMAND_PUBLISHERS = 9  # `number` of them, 0 for one or none; below 0: of those of another message type
    LVDT_PUBLISHERS = 10
    VOLTAGE_PUBLISHERS = 11
    TRAJECTORY = 12  # position, velocity and acceleration as `command`, `reading` and `number`; its stamp as
    # `elapsed` (0.0: none) and since as `voltage`
    TRAJECTORY_REFUSED = 13  # for its numbers of entries, in the same columns
    TRAJECTORY_GONE = 14  # who sent it left, somebody who commands did not
    TRAJECTORY_PUBLISHERS = 15


OBSERVED = {
    "spool_command": (Event.COMMAND_PUBLISHERS, "command_publishers"),
    "spool_trajectory": (Event.TRAJECTORY_PUBLISHERS, "trajectory_publishers"),
    "spool_position": (Event.LVDT_PUBLISHERS, "lvdt_publishers"),
    "valve_voltage": (Event.VOLTAGE_PUBLISHERS, "voltage_publishers"),
}
NUMBER = "std_msgs/msg/Float64"
TYPES = {topic: NUMBER for topic in OBSERVED} | {
    "spool_trajectory": "trajectory_msgs/msg/JointTrajectoryPoint"
}
COUNTED = tuple(event for event, _ in OBSERVED.values())


class Journal:
    """Passes inputs to ``supervisor`` and keeps a row of each; ``clock`` [ns] gives their times."""

    def __init__(self, supervisor: Supervisor, clock: Callable[[], int] = time.time_ns) -> None:
        self._supervisor = supervisor
        self._clock = clock
        self._rows = array("d")
        self._run = clock()  # ns, by which this journal is known from others
        self._base = 0  # ns
        self._count = 0  # rows since the beginning
        self._command = math.nan  # taken, and not in a row yet
        self._epochs = {"command": 0, "trajectory": 0}  # ns  of the senders' clocks, since which stamps count
        self._stamps = {"command": 0.0, "trajectory": 0.0}  # s  the last ones
        self._publishers = dict.fromkeys(OBSERVED, 0)
        self.owes_account = True  # of parameters that came into use

    def __len__(self) -> int:
        """Number of rows that wait to be taken."""
        return len(self._rows) // len(COLUMNS)

    # Inputs of the supervisor

    def command(self, value: float, stamp: int = 0, since: float = 0.0) -> None:
        """Pass on a command [V] from the upper level, sent at ``stamp`` [ns], 0 if that is not known.

        ``since`` [s]: how long after the last reading, silence or skipped reading it came.
        """
        self._close_command()
        time = self._seconds("command", stamp)
        self._supervisor.command(value, time, since)
        self._command = value
        if math.isnan(value) or stamp:
            self._note(Event.COMMAND, time, since)

    def trajectory(self, point: Motion, stamp: int = 0, since: float = 0.0) -> None:
        """A point of a trajectory, of the time ``stamp`` [ns], 0 if that is not known; ``since`` as above."""
        self._close_command()
        time = self._seconds("trajectory", stamp)
        self._supervisor.trajectory(point, time, since)
        self._command = point.position
        times = (time, since) if stamp else (0.0, math.nan)
        self._note(Event.TRAJECTORY, point.velocity, point.acceleration, *times)

    def _seconds(self, kind: str, stamp: int) -> float:
        """``stamp`` [ns] in s, from a moment on that keeps it short, by another one LATER than before."""
        if stamp == 0:
            return math.nan
        if abs(stamp - self._epochs[kind]) > LONG:
            self._epochs[kind] = stamp - round((self._stamps[kind] + LATER) * 1e9)
        self._stamps[kind] = (stamp - self._epochs[kind]) * 1e-9
        return self._stamps[kind]

    def trajectory_refused(self, positions: int, velocities: int, accelerations: int) -> None:
        """A point of a trajectory with so many entries."""
        self._close_command()
        self._supervisor.trajectory_refused(positions, velocities, accelerations)
        self._command = float(positions)
        self._note(Event.TRAJECTORY_REFUSED, float(velocities), float(accelerations))

    def trajectory_gone(self) -> None:
        """Who sent the trajectory has left; once more is nothing new."""
        if self._supervisor.has_trajectory:
            self._supervisor.trajectory_gone()
            self._note(Event.TRAJECTORY_GONE)

    def sample(
        self, reading: float, number: int, elapsed: float, give: Callable[[float], None] = unused
    ) -> float:
        """Pass on a reading [V]; returns the voltage [V]. See Supervisor.sample."""
        voltage = self._supervisor.sample(reading, number, elapsed, give)
        self._note(Event.READING, reading, number, elapsed, voltage)
        return voltage

    def silence(self, elapsed: float, stalled: bool = False) -> float:
        """Report that the LVDT is silent; returns the voltage [V], NaN if there has been no reading yet."""
        voltage = self._supervisor.silence(elapsed, stalled)
        voltage = voltage if self._supervisor.begun else math.nan
        self._note(Event.STALL if stalled else Event.SILENCE, elapsed=elapsed, voltage=voltage)
        return voltage

    def skip(self, reading: float, number: int, elapsed: float) -> float:
        """Record a reading that came while this process stood still; returns the voltage [V]."""
        voltage = self._supervisor.skip(elapsed)
        self._note(Event.STALL, reading, number, elapsed, voltage)
        return voltage

    def apply(self, values: Values, params: Any) -> None:
        """Pass on new parameters. See Supervisor.apply."""
        self._supervisor.apply(values, params)
        self._note(Event.PARAMETERS)
        self.owes_account = True

    def start(self) -> None:
        """Begin at rest with 0 V."""
        self._rest()
        self._note(Event.START)

    def stop(self) -> float:
        """Go to rest; returns 0 V."""
        self._rest()
        self._note(Event.STOP, voltage=0.0)
        return 0.0

    def reset(self) -> None:
        """Set estimates and filters to their start."""
        self._supervisor.reset()
        self._note(Event.RESET)

    def command_gone(self) -> None:
        """Report that the upper level has left; repeated calls change nothing."""
        if not self._supervisor.command_left:
            self._supervisor.command_gone()
            self._note(Event.COMMAND_GONE)

    def publishers(self, topic: str, count: int) -> None:
        """Report how many publishers ``topic``, one of OBSERVED, has; -n: n have another message type."""
        several = count if count > 1 or count < 0 else 0
        if several != self._publishers[topic]:
            self._publishers[topic] = several
            event, _ = OBSERVED[topic]
            observe(self._supervisor, event, several)
            self._note(event, number=several)

    # What is kept

    def _close_command(self) -> None:
        """A command that waits for the row of a reading gets one of its own."""
        if not math.isnan(self._command):
            self._note(Event.COMMAND)

    def take(self) -> array:  # type: ignore[type-arg]  # not subscriptable at run time
        """Return the rows since the last call, after HEAD numbers; an empty array without rows."""
        self._close_command()
        taken = array("d")
        if self._rows:
            taken.extend((*divmod(self._run, 10**9), self._count - len(self), *divmod(self._base, 10**9)))
            taken.extend(self._rows)
            del self._rows[:]
        return taken

    def account(self) -> str:
        """Snapshot (text) of all that the supervisor remembers before the next row; call after ``take``."""
        self.owes_account = False
        return snapshot(self._supervisor, self._run, self._count)

    def _rest(self) -> None:
        self._supervisor.start()
        self._publishers = dict.fromkeys(OBSERVED, 0)  # they are reported anew

    def _note(
        self,
        event: Event,
        reading: float = math.nan,
        number: float = math.nan,
        elapsed: float = 0.0,
        voltage: float = math.nan,
    ) -> None:
        now = self._clock()
        if not self._rows:
            self._base = now
        self._rows.extend((now - self._base, event, self._command, reading, number, elapsed, voltage))
        self._command = math.nan
        self._count += 1


def observe(supervisor: Supervisor, event: Event, count: int) -> None:
    """Tell ``supervisor`` of ``count`` publishers (0: one or none, -n: n of another message type)."""
    for topic, (kind, name) in OBSERVED.items():
        if kind is event:
            text = f"{count} publishers on {topic}" if count else ""
            if count < 0:
                text = f"{-count} of the publishers on {topic} have another message type than {TYPES[topic]}"
            supervisor.observe(name, text)


class Block(NamedTuple):
    """Consecutive rows of a journal."""

    run: int  # which journal
    first: int  # number of the first row
    time: npt.NDArray[np.int64]  # ns
    rows: npt.NDArray[np.float64]  # n x len(COLUMNS)

    def follows(self, before: "Block | None") -> bool:
        """Whether no row is missing between ``before`` and this one."""
        return before is not None and (self.run, self.first) == (before.run, before.first + len(before.rows))


def block(data: Sequence[float] | npt.NDArray[np.float64]) -> Block:
    """Parse what ``take`` returned. Raises ValueError if it is something else."""
    numbers = np.asarray(data, dtype=np.float64)
    head, rows = numbers[:HEAD], numbers[HEAD:]
    if len(rows) == 0 or len(rows) % len(COLUMNS) or not np.isfinite(head).all():
        raise ValueError("no rows of a journal")
    rows = rows.reshape(-1, len(COLUMNS))
    time, event, _, _, number, elapsed, _ = rows.T
    numbered = np.isin(event, (Event.READING, *COUNTED))
    counted = np.isfinite(rows[:, 2:5]).all(axis=1) | (event != Event.TRAJECTORY_REFUSED)
    sound = np.isin(event, list(Event)) & (np.isfinite(number) | ~numbered) & counted
    if not (sound & np.isfinite(time) & np.isfinite(elapsed)).all():
        raise ValueError("rows of another journal")
    run, base = (int(head[i]) * 10**9 + int(head[i + 1]) for i in (0, 3))
    return Block(run, int(head[2]), base + time.astype(np.int64), rows)
