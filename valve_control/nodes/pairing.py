# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds out, in lockstep, which command belongs to which reading, from their sequence numbers."""

from collections.abc import Callable
from typing import Any

from valve_control.nodes.adapter import number_of

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
