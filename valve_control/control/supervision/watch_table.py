# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The table of all watches: what each remembers, which parameters it has, which conditions it reports.

Two kinds of watch:

REPORTS  looks at each block of the plausibility check and reports a condition; the law goes on.
GUIDES   is called by name in watch.py or supervisor.py, because more than its sentence depends on it: which
         reading or command counts, or when the law starts again.

Why each of the guides stays one (a step that takes and returns one State would not make watch.py shorter):

lvdt, lvdt_watch   decide whether the reading counts at all, before the law steps, and end the time at 0 V
rate               needs the real time between readings, which exported C does not have
plausibility       makes the blocks that REPORTS watches look at, and its doubt limits the law's voltage
answer             doubt halves what it allows, and the law starts again with the estimates that it proves
command_watch,     give the law its command; their states are read at five places of a sample
command_course
cycle_watch        has five slots: four change once in a cycle or never, and one State of all five would cost
                   0.4 µs at each sample (Python 3.11), a twentieth of the whole sample
law_watch          one of its conditions is an event, the other has a hysteresis and a counter, and both look
                   at the terms of a law; a new assumption is one row of ``law_watch.ASSUMPTIONS``

A new watch that REPORTS is one file and one row of ``WATCHES``. Memory, snapshot, diagnostics and the page
docs/reference/modes.md follow from the row. Exported C leaves it out. The file has ``Params``, ``State``,
``NOTHING`` (the state at the start), ``CONDITIONS`` and these functions:

design(values, check)   Params from the controller's values and the Params of the plausibility check
step(p, s, seen)        the state after one more block, of which ``seen`` is a ``plausibility.SeenBlock``
found(p, s)             whether the condition is there
text(p, s)              one sentence for the user
stopped(s)              the state after the voltage was switched off, whatever the reason
forgotten(s)            the state after ~/reset, or under another model of the valve
"""

import collections
import types
from typing import Any, NamedTuple

from valve_control.control.supervision import (
    answer,
    command_course,
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

REPORTS, GUIDES = "reports", "guides"


class Watch(NamedTuple):
    """One watch."""

    module: types.ModuleType
    slots: tuple[str, ...]  # of the memory; that of a watch which REPORTS holds its State
    kind: str = GUIDES
    parameters: tuple[str, ...] = ()  # of the controller

    @property
    def slot(self) -> str:
        """The only slot of a watch that REPORTS."""
        (slot,) = self.slots
        return slot

    @property
    def condition(self) -> str:
        """Name of the only condition of such a watch."""
        ((name,),) = (condition.names for condition in self.module.CONDITIONS)
        return str(name)


WATCHES = (
    Watch(
        lvdt,
        ("judged", "jumped_until"),
        parameters=(
            *("lvdt.limit", "lvdt.max_rate", "lvdt.tolerance", "lvdt.frozen_samples", "lvdt.frozen_voltage"),
        ),
    ),
    Watch(lvdt_watch, ("trust",), parameters=("lvdt.hold_samples", "lvdt.recovery_samples")),
    Watch(rate, ("pace",), parameters=("lvdt.period_limit",)),
    Watch(
        plausibility,
        ("evidence",),
        parameters=(
            *("lvdt.disturbance", "lvdt.excitation", "lvdt.slow", "lvdt.hold_off", "lvdt.hold_off_limit"),
        ),
    ),
    Watch(answer, ("response", "proven")),
    Watch(noise_watch, ("noise",), REPORTS),
    Watch(stick_watch, ("stick",), REPORTS),
    Watch(gain_watch, ("gain",), REPORTS),
    Watch(hum_watch, ("hum",), REPORTS),
    Watch(
        command_watch,
        ("command",),
        parameters=("command_limit", "command_timeout", "neutral_rate", "neutral_accel"),
    ),
    Watch(
        command_course, ("course", "clock", "pulse", "sender"), parameters=("command.bridge", "command.lag")
    ),
    Watch(
        cycle_watch,
        ("cycle", "swing", "probe", "source", "pause"),
        parameters=("oscillation_limit",),
    ),
    Watch(law_watch, ("saturated_for",), parameters=("saturation_limit",)),
)
REPORTING = tuple(watch for watch in WATCHES if watch.kind == REPORTS)
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
    own = (condition for watch in WATCHES for condition in getattr(watch.module, "CONDITIONS", ()))
    return (*own, *OF_NODES)


def design(values: Values, check: plausibility.Params | None) -> Any:
    """Params of the watches beside the plausibility ``check``; None without it."""
    return None if check is None else Params(*(watch.module.design(values, check) for watch in REPORTING))
