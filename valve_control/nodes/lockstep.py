# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A controller in lockstep: a reading is answered when its command has come, however long that takes."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from valve_control.nodes.adapter import PolledSubscription, needs_numbers, number_of
from valve_control.nodes.loop import Failure

LOOK = 0.01  # s  between two looks at what a reading waits for
MEET = 5.0  # s  who gives the readings has so long to become ready for voltages
COMMANDED = {False: 5.0, True: 20.0}  # s  a command is waited for, by whether anybody commands
COMMANDING = ("spool_command", "spool_trajectory")
NEVER = float("inf")

Reading = tuple[float, dict[str, Any]]  # V, message info
Numbered = tuple[Any, dict[str, Any]]  # command or point of a trajectory, message info


class Pairing:
    """Takes waiting commands one by one, each at the reading that it was sent for.

    A command source sends its first command at once and one more for each reading, so that of a simulator and
    a source that began together command k is for reading k, and no command is more than one ahead. If one of
    the two began anew, its numbers begin anew, and the next command is for the next reading.
    """

    def __init__(self, take: Callable[[], Numbered | None], use: Callable[[Any], None]) -> None:
        self._take = take
        self._use = use
        self._held: tuple[int, Any] | None = None  # a command that came before its reading
        self._ahead: int | None = None  # number of a command less that of its reading
        self._command = 0  # number of the last command
        self._reading = 0  # number of the last reading

    @property
    def begun(self) -> bool:
        """Whether it is known which command is for which reading."""
        return self._ahead is not None

    def anew(self, reading: int) -> bool:
        """Whether ``reading`` is the first of all, or of a simulator that was started again."""
        return self._reading == 0 or reading < self._reading

    def give_up(self) -> None:
        """Stop waiting for commands: the next one is for the reading at which it comes."""
        self._ahead = None

    def complete(self, reading: int) -> bool:
        """Pass on the commands up to the one for ``reading``; returns whether none is missing."""
        if reading < self._reading:
            self._ahead = None
        self._reading = reading
        while True:
            if self._held is None:
                taken = self._take()
                if taken is None:
                    return False
                self._held = (number_of(taken[1]), taken[0])
                if self._held[0] <= self._command:
                    self._ahead = None
                self._command = self._held[0]
            number, command = self._held
            if self._ahead is None:
                self._ahead = number - reading if number - reading not in (0, 1) else 0
            if number - self._ahead > reading:
                return True
            self._held = None
            self._use(command)
            if number - self._ahead == reading:
                return True


class Lockstep:
    """Holds the newest reading back until its command, one of ``commands``, has been given to ``use``.

    ``acquainted``: whether who gives the readings will hear the voltages of ``node``.
    """

    def __init__(
        self,
        node: Any,
        commands: Sequence[PolledSubscription],
        use: Callable[[Any], None],
        acquainted: Callable[[], bool],
    ) -> None:
        self._node = node
        self._commands = commands
        self._acquainted = acquainted
        self._pairing = Pairing(self._next_command, use)
        self._since = NEVER  # s, when the reading came that waits
        self.waiting: Reading | None = None
        self.look_at = NEVER  # s, next look at what it waits for
        self.met = False  # whether who gives the readings is ready for voltages
        self.uncommanded = False  # whether there is nobody who commands

    def inputs(self) -> Sequence[PolledSubscription]:
        """What a reading that waits needs next."""
        return self._commands if self.met else ()

    def next(self, readings: Any) -> Reading | None:
        """The newest of ``readings`` if its command has come; the simulator waits for no older one."""
        now = time.monotonic()
        for taken in readings.take():
            self.waiting, self._since = taken, now
        if self.waiting is None:
            return None
        number = number_of(self.waiting[1])
        if number == 0:
            raise Failure(needs_numbers("lockstep"))
        if not self._complete(number, now):
            self.look_at = now + LOOK
            return None
        taken, self.waiting, self.look_at = self.waiting, None, NEVER
        return taken

    def _next_command(self) -> Numbered | None:
        """The oldest command or point of a trajectory that waits."""
        return next((taken for one in self._commands if (taken := one.one()) is not None), None)

    def _complete(self, number: int, now: float) -> bool:
        """Whether the command for reading ``number`` has come, or is no longer waited for."""
        waited = now - self._since
        if self._pairing.anew(number):
            self.met = False
        self.met = self.met or waited > MEET or self._acquainted()
        if not self.met:
            return False
        if self._pairing.complete(number):
            self.uncommanded = False
            return True
        if self.uncommanded:
            return True
        if waited < LOOK:
            return False
        commanded = any(self._node.count_publishers(topic) > 0 for topic in COMMANDING)
        if waited < COMMANDED[commanded] and (commanded or not self._pairing.begun):
            return False
        self._pairing.give_up()
        self.uncommanded = True
        self._node.get_logger().warning(
            f"lockstep: no command for reading {number} within {waited:.2g} s; goes on without waiting"
        )
        return True
