# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Records all inputs and outputs of a supervisor, row by row, so that a run can be repeated bit for bit.

Topics do not tell which command was in force when a reading was answered, which readings never came, or when
parameters took effect; the journal does, since the supervisor notes them in it.
"""

import math
import time
from array import array
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

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


ALONE, CHANGE = Event.COMMAND, Event.PARAMETERS  # an access to a member takes as long as half a row
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
COUNTED = {event: topic for topic, (event, _) in OBSERVED.items()}


class Journal:
    """Keeps the rows that a ``Supervisor(journal.note)`` notes; ``clock`` [ns] gives their times."""

    def __init__(self, clock: Callable[[], int] = time.time_ns) -> None:
        self._clock = clock
        self._rows = array("d")
        self.run = clock()  # ns, by which this journal is known from others
        self.count = 0  # rows since the beginning
        self._base = 0  # ns
        self._command = math.nan  # taken, and not in a row yet
        self._epochs = {"command": 0, "trajectory": 0}  # ns  of the senders' clocks
        self._stamps = {"command": 0.0, "trajectory": 0.0}  # s  the last ones
        self.owes_account = True  # of parameters that came into use

    def __len__(self) -> int:
        """Number of rows that wait to be taken."""
        return len(self._rows) // len(COLUMNS)

    def seconds(self, kind: str, stamp: int) -> float:
        """``stamp`` [ns] of a command or trajectory in s, NaN for 0, which is unknown.

        It counts from a moment on that keeps it short, by another one LATER than before.
        """
        if stamp == 0:
            return math.nan
        if abs(stamp - self._epochs[kind]) > LONG:
            self._epochs[kind] = stamp - round((self._stamps[kind] + LATER) * 1e9)
        self._stamps[kind] = (stamp - self._epochs[kind]) * 1e-9
        return self._stamps[kind]

    def note(
        self,
        event: Event,
        reading: float = math.nan,
        number: float = math.nan,
        elapsed: float = 0.0,
        voltage: float = math.nan,
        command: float | None = None,
    ) -> None:
        """Write a row; a ``command`` [V] without a time stamp waits for the row of the next event."""
        if command is not None:
            if not math.isnan(self._command):
                self.note(ALONE)
            self._command = command
            if event is ALONE and math.isnan(reading) and not math.isnan(command):
                return
        now = self._clock()
        if not self._rows:
            self._base = now
        self._rows.extend((now - self._base, event, self._command, reading, number, elapsed, voltage))
        self._command = math.nan
        self.count += 1
        self.owes_account = self.owes_account or event is CHANGE

    def take(self) -> array:  # type: ignore[type-arg]  # not subscriptable at run time
        """Return the rows since the last call, after HEAD numbers; an empty array without rows."""
        if not math.isnan(self._command):
            self.note(ALONE)
        taken = array("d")
        if self._rows:
            taken.extend((*divmod(self.run, 10**9), self.count - len(self), *divmod(self._base, 10**9)))
            taken.extend(self._rows)
            del self._rows[:]
        return taken


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
