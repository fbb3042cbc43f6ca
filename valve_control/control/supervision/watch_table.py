# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The table of the watches that report.

A watch of this table looks at each block of the plausibility check and reports a condition; the law goes on.
The other watches are called by name in control_step.py or supervisor.py, because more than a sentence
depends on them: which reading or command counts, what limits the voltage, or when the law starts again.

A new watch that reports is one file, one row of ``REPORTING`` and its line in docs/reference/modes.md. Memory
and snapshot follow from the row; exported C has no such watch. The file has ``Params``, ``State``,
``NOTHING`` (the state at the start) and these functions:

design(values, check)   Params from the controller's values and the Params of the plausibility check
step(p, s, block)       the state after one more block, a ``plausibility.Block``
text(p, s)              one sentence for the user, "" while the condition is not there
stopped(s)              the state after the voltage was switched off; without this function the same
forgotten(s)            the state after ~/reset, or under another model of the valve; without it ``NOTHING``
"""

import collections
import types
from typing import Any, NamedTuple

from valve_control.control.supervision import gain_watch, noise_watch, plausibility, stick_watch
from valve_control.parameter import Values


class Watch(NamedTuple):
    """A watch that reports."""

    module: types.ModuleType
    slot: str  # of the memory, which holds its State
    condition: str  # that it reports

    def stopped(self, state: Any) -> Any:
        """State after the voltage was switched off."""
        return self.module.stopped(state) if hasattr(self.module, "stopped") else state

    def forgotten(self, state: Any) -> Any:
        """State after a reset, or under another model of the valve."""
        forgotten = getattr(self.module, "forgotten", None)
        return self.module.NOTHING if forgotten is None else forgotten(state)


REPORTING = (
    Watch(noise_watch, "noise", "lvdt_noise"),
    Watch(stick_watch, "stick", "spool_sticks"),
    Watch(gain_watch, "gain", "lvdt_gain"),
)
Params = collections.namedtuple("Params", [watch.slot for watch in REPORTING])  # type: ignore[misc]


def design(values: Values, check: plausibility.Params | None) -> Any:
    """Params of the watches beside the plausibility ``check``; None without it."""
    return None if check is None else Params(*(watch.module.design(values, check) for watch in REPORTING))
