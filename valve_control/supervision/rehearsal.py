"""A sample gone through shortly before the next reading comes, so that the CPU's caches hold what it needs.

Between two readings a process sleeps, and others take the caches: a sample then costs three times what it
costs in a tight loop. See docs/profile.md.
"""

import time

from valve_control.parameters.table import Values
from valve_control.supervision.journal import Journal
from valve_control.supervision.supervisor import Supervisor


class Rehearsal:
    """A supervisor of the same parameters, whose voltages nobody sees."""

    def __init__(self) -> None:
        self._supervisor = Supervisor()
        self._journal = Journal(self._supervisor)
        self._number = 0
        self._played = 0.0  # s

    def apply(self, values: Values, params: object) -> None:
        """Parameters as the real one has them."""
        self._journal.apply(values, params)

    def start(self) -> None:
        """Begin at rest, together with the real one."""
        self._journal.start()
        self._journal.take()

    def play(self, real: Supervisor) -> None:
        """Answer once more what ``real`` answered last."""
        if real.command_in_force is not None:
            self._journal.command(real.command_in_force)
        self._number += 1
        before, self._played = self._played, time.monotonic()
        self._journal.sample(real.measurement, self._number, self._played - before)
        self._journal.take()
