"""All that a supervisor takes in and gives, row by row: with it a run can be repeated bit for bit.

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

from valve_control.parameters.table import Values
from valve_control.supervision.memory import remember
from valve_control.supervision.supervisor import Supervisor, unused

COLUMNS = ("time", "event", "command", "reading", "number", "elapsed", "voltage")
HEAD = 5  # numbers before the rows: which journal, number of the first row, time 0; times in s and ns


class Event(IntEnum):
    """What a row tells; before it the row's command was taken, if that is not NaN."""

    READING = 0  # answered with a voltage
    SILENCE = 1  # of the LVDT
    STALL = 2  # this process stood still; the reading, if there was one, was not used
    COMMAND = 3  # nothing but the command, NaN included
    PARAMETERS = 4  # new ones are in use, which the account before the next row tells
    START = 5  # from rest
    STOP = 6  # with 0 V
    RESET = 7
    COMMAND_GONE = 8  # the upper level left
    COMMAND_PUBLISHERS = 9  # `number` of them, 0 for one or none
    LVDT_PUBLISHERS = 10


OBSERVED = {
    "spool_command": (Event.COMMAND_PUBLISHERS, "command_publishers"),
    "spool_position": (Event.LVDT_PUBLISHERS, "lvdt_publishers"),
}


class Journal:
    """Hands inputs on to ``supervisor`` and keeps a row of each; ``clock`` [ns] gives their times."""

    def __init__(self, supervisor: Supervisor, clock: Callable[[], int] = time.time_ns) -> None:
        self._supervisor = supervisor
        self._clock = clock
        self._rows = array("d")
        self._run = clock()  # ns, by which this journal is known from others
        self._base = 0  # ns
        self._count = 0  # rows since the beginning
        self._command = math.nan  # taken, and not in a row yet
        self._publishers = dict.fromkeys(OBSERVED, 0)
        self.owes_account = True  # of parameters that came into use

    def __len__(self) -> int:
        """Rows that wait to be taken."""
        return len(self._rows) // len(COLUMNS)

    # Inputs of the supervisor

    def command(self, value: float) -> None:
        """A command [V] from the upper level."""
        self._supervisor.command(value)
        if not math.isnan(self._command):
            self._note(Event.COMMAND)
        self._command = value
        if math.isnan(value):
            self._note(Event.COMMAND)

    def sample(
        self, reading: float, number: int, elapsed: float, give: Callable[[float], None] = unused
    ) -> float:
        """A reading [V]; returns the voltage [V]. See Supervisor.sample."""
        voltage = self._supervisor.sample(reading, number, elapsed, give)
        self._note(Event.READING, reading, number, elapsed, voltage)
        return voltage

    def silence(self, elapsed: float, stalled: bool = False) -> float:
        """The LVDT is silent; returns the voltage [V], NaN if there has been no reading yet."""
        voltage = self._supervisor.silence(elapsed, stalled)
        voltage = voltage if self._supervisor.begun else math.nan
        self._note(Event.STALL if stalled else Event.SILENCE, elapsed=elapsed, voltage=voltage)
        return voltage

    def skip(self, reading: float, number: int, elapsed: float) -> float:
        """A reading that came while this process stood still; returns the voltage [V]."""
        voltage = self._supervisor.silence(elapsed, stalled=True)
        self._note(Event.STALL, reading, number, elapsed, voltage)
        return voltage

    def apply(self, values: Values, params: Any) -> None:
        """New parameters. See Supervisor.apply."""
        self._supervisor.apply(values, params)
        self._note(Event.PARAMETERS)
        self.owes_account = True

    def start(self) -> None:
        """Begin at rest."""
        self._rest()
        self._note(Event.START)

    def stop(self) -> float:
        """To rest; returns 0 V."""
        self._rest()
        self._note(Event.STOP, voltage=0.0)
        return 0.0

    def reset(self) -> None:
        """Estimates and filters to their start."""
        self._supervisor.reset()
        self._note(Event.RESET)

    def command_gone(self) -> None:
        """The upper level has left; once more is nothing new."""
        if not self._supervisor.command_left:
            self._supervisor.command_gone()
            self._note(Event.COMMAND_GONE)

    def publishers(self, topic: str, count: int) -> None:
        """How many publishers there are on ``topic``, spool_command or spool_position."""
        several = count if count > 1 else 0
        if several != self._publishers[topic]:
            self._publishers[topic] = several
            event, _ = OBSERVED[topic]
            observe(self._supervisor, event, several)
            self._note(event, number=several)

    # What is kept

    def take(self) -> array:  # type: ignore[type-arg]  # not subscriptable at run time
        """The rows since the last call, after HEAD numbers; nothing if there are none."""
        if not math.isnan(self._command):
            self._note(Event.COMMAND)
        taken = array("d")
        if self._rows:
            taken.extend((*divmod(self._run, 10**9), self._count - len(self), *divmod(self._base, 10**9)))
            taken.extend(self._rows)
            del self._rows[:]
        return taken

    def account(self) -> str:
        """All that the supervisor remembers before the next row; after ``take``."""
        self.owes_account = False
        return remember(self._supervisor, self._run, self._count)

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
    """Tell ``supervisor`` that there are ``count`` publishers, 0 for one or none."""
    for topic, (kind, name) in OBSERVED.items():
        if kind is event:
            supervisor.observe(name, f"{count} publishers on {topic}" if count else "")


class Block(NamedTuple):
    """Rows of a journal that follow each other."""

    run: int  # which journal
    first: int  # number of the first row
    time: npt.NDArray[np.int64]  # ns
    rows: npt.NDArray[np.float64]  # n x len(COLUMNS)

    def follows(self, before: "Block | None") -> bool:
        """Whether no row is missing between ``before`` and this one."""
        return before is not None and (self.run, self.first) == (before.run, before.first + len(before.rows))


def block(data: Sequence[float] | npt.NDArray[np.float64]) -> Block:
    """What ``take`` gave. Raises ValueError if it is none."""
    numbers = np.asarray(data, dtype=np.float64)
    head, rows = numbers[:HEAD], numbers[HEAD:]
    if len(rows) == 0 or len(rows) % len(COLUMNS) or not np.isfinite(head).all():
        raise ValueError("no rows of a journal")
    rows = rows.reshape(-1, len(COLUMNS))
    time, event, _, _, number, elapsed, _ = rows.T
    numbered = np.isin(event, (Event.READING, Event.COMMAND_PUBLISHERS, Event.LVDT_PUBLISHERS))
    sound = np.isin(event, list(Event)) & (np.isfinite(number) | ~numbered)
    if not (sound & np.isfinite(time) & np.isfinite(elapsed)).all():
        raise ValueError("rows of another journal")
    run, base = (int(head[i]) * 10**9 + int(head[i + 1]) for i in (0, 3))
    return Block(run, int(head[2]), base + time.astype(np.int64), rows)
