# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A controller in lockstep: a reading is answered when its command has come, however long that takes."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from valve_control.nodes.adapter import PolledSubscription, needs_numbers, number_of
from valve_control.nodes.loop import Failure
from valve_control.nodes.pairing import Pairing

LOOK = 0.01  # s  between two looks at what a reading waits for
MEET = 5.0  # s  who gives the readings has so long to become ready for voltages
COMMANDED = {False: 5.0, True: 20.0}  # s  a command is waited for, by whether anybody commands
COMMANDING = ("spool_command", "spool_trajectory")
NEVER = float("inf")

Reading = tuple[float, dict[str, Any]]  # V, message info


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

    def _next_command(self) -> tuple[Any, dict[str, Any]] | None:
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
