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
REMIND = 5.0  # s  between two warnings that there is no command
COMMANDING = ("spool_command", "spool_trajectory")
NEVER = float("inf")

Numbered = tuple[Any, dict[str, Any]]  # reading [V], command [V] or point of a trajectory; message info


class Lockstep:
    """Holds the newest reading back until the command of its number, of ``commands``, was given to ``use``.

    A command source sends its first command at once and one more for each reading, so that command k is for
    reading k. ``acquainted``: whether who gives the readings will hear the voltages of ``node``.
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
        self._use = use
        self._acquainted = acquainted
        self._command: Numbered | None = None  # that came before its reading
        self._since = self._remind_at = NEVER  # s, when the reading came that waits
        self._met = False  # whether who gives the readings is ready for voltages
        self.waiting: Numbered | None = None  # the reading
        self.look_at = NEVER  # s, next look at what it waits for

    def inputs(self) -> Sequence[PolledSubscription]:
        """What a reading that waits needs next."""
        return self._commands if self._met else ()

    def next(self, readings: Any) -> Numbered | None:
        """The newest of ``readings`` if its command has come; the simulator waits for no older one."""
        now = time.monotonic()
        for taken in readings.take():
            self.waiting, self._since, self._remind_at = taken, now, now + REMIND
        if self.waiting is None:
            return None
        number = number_of(self.waiting[1])
        if number == 0:
            raise Failure(needs_numbers("lockstep"))
        self._met = self._met or now - self._since > MEET or self._acquainted()
        if not (self._met and self._complete(number)):
            self.look_at = now + LOOK
            if now > self._remind_at:
                self._remind_at = now + REMIND
                self._node.get_logger().warning(f"lockstep: reading {number} waits for its command")
            return None
        taken, self.waiting, self.look_at = self.waiting, None, NEVER
        return taken

    def _complete(self, reading: int) -> bool:
        """Pass on the commands up to the one for ``reading``; whether none is missing."""
        while True:
            if self._command is None:
                self._command = next((taken for one in self._commands if (taken := one.one())), None)
            if self._command is None:
                return False
            command, number = self._command[0], number_of(self._command[1])
            if number > reading:
                return True
            self._command = None
            self._use(command)
            if number == reading:
                return True
