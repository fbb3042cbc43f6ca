# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes a sample before the next reading comes, so that its code is in the CPU's caches (cache warming).

Between two readings a process sleeps, and others take the caches: a sample then costs three times what it
costs in a tight loop. See docs/explanation/profile.md.
"""

from valve_control.control.supervision.journal import Journal
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import Values


class CacheWarming:
    """A second supervisor with the same parameters, whose voltages are thrown away."""

    def __init__(self) -> None:
        self._journal = Journal()
        self._supervisor = Supervisor(self._journal.note)
        self._supervisor.answered = False
        self._number = 0

    def apply(self, values: Values, params: object) -> None:
        """Take the same parameters into use as the real supervisor."""
        self._supervisor.apply(values, params)

    def start(self) -> None:
        """Begin at rest, together with the real supervisor."""
        self._supervisor.start()
        self._journal.take()

    def warm(self, real: Supervisor) -> None:
        """Repeat the last answer of ``real``."""
        if real.memory.command.value is not None:
            self._supervisor.command(real.memory.command.value)
        self._number += 1
        self._supervisor.sample(real.memory.measurement, self._number, 0.0)
        self._journal.take()
