# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The table of the watches that report, and the conditions of all watches.

A watch of this table looks at each block of the plausibility check and reports a condition; the law goes on.
The other watches are called by name in watch.py or supervisor.py, because more than a sentence depends on
them: which reading or command counts, what limits the voltage, or when the law starts again.

A new watch that reports is one file and one row of ``REPORTING``. Memory, snapshot, diagnostics and the page
docs/reference/modes.md follow from the row; exported C has no such watch. The file has ``Params``, ``State``,
``NOTHING`` (the state at the start), ``CONDITIONS`` and these functions:

design(values, check)   Params from the controller's values and the Params of the plausibility check
step(p, s, seen)        the state after one more block, of which ``seen`` is a ``plausibility.SeenBlock``
found(p, s)             whether the condition is there
text(p, s)              one sentence for the user
stopped(s)              the state after the voltage was switched off; without this function the same
forgotten(s)            the state after ~/reset, or under another model of the valve; without it ``NOTHING``
"""

import collections
import types
from typing import Any, NamedTuple

from valve_control.control.supervision import (
    command_watch,
    cycle_watch,
    gain_watch,
    hum_watch,
    law_watch,
    lvdt,
    lvdt_watch,
    noise_watch,
    plausibility,
    rate,
    stick_watch,
)
from valve_control.control.supervision.conditions import ReportedCondition
from valve_control.parameter import Values


class Watch(NamedTuple):
    """A watch that reports."""

    module: types.ModuleType
    slot: str  # of the memory, which holds its State

    @property
    def condition(self) -> str:
        """Name of its only condition."""
        ((name,),) = (condition.names for condition in self.module.CONDITIONS)
        return str(name)

    def stopped(self, state: Any) -> Any:
        """State after the voltage was switched off."""
        return self.module.stopped(state) if hasattr(self.module, "stopped") else state

    def forgotten(self, state: Any) -> Any:
        """State after a reset, or under another model of the valve."""
        forgotten = getattr(self.module, "forgotten", None)
        return self.module.NOTHING if forgotten is None else forgotten(state)


REPORTING = (
    Watch(noise_watch, "noise"),
    Watch(stick_watch, "stick"),
    Watch(gain_watch, "gain"),
    Watch(hum_watch, "hum"),
)
MODULES = (
    *(lvdt, lvdt_watch, rate, plausibility, *(watch.module for watch in REPORTING)),
    *(command_watch, cycle_watch, law_watch),
)
Params = collections.namedtuple("Params", [watch.slot for watch in REPORTING])  # type: ignore[misc]
OF_NODES = (
    ReportedCondition(
        ("command_publishers", "trajectory_publishers", "lvdt_publishers", "voltage_publishers"),
        "degraded",
        "2 publishers on spool_command (spool_trajectory, spool_position, valve_voltage); … of the "
        "publishers on … have another message type than …",
        "another node publishes too, or with a message type that is not read; a publisher that was "
        "killed stays in the graph for up to 20 s",
        "`ros2 topic info -v`",
    ),
)  # what is no watch's, but that of who runs the supervisor


def conditions() -> tuple[ReportedCondition, ...]:
    """All conditions, watch by watch."""
    return (*(condition for module in MODULES for condition in module.CONDITIONS), *OF_NODES)


def design(values: Values, check: plausibility.Params | None) -> Any:
    """Params of the watches beside the plausibility ``check``; None without it."""
    return None if check is None else Params(*(watch.module.design(values, check) for watch in REPORTING))
