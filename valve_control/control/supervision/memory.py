# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Holds all that a supervisor remembers between two samples, and reports conditions in it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, make_dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from valve_control.control.laws import command_lead
from valve_control.control.laws import velocity as tachometer
from valve_control.control.supervision import (
    answer,
    bumpless_transfer,
    command_course,
    command_watch,
    cycle_watch,
    lock_in,
    lvdt,
    lvdt_trust,
    oscillation,
    plausibility,
    rate,
)
from valve_control.control.supervision import clock as clocks
from valve_control.control.supervision import trajectory as points
from valve_control.control.supervision.watch_table import REPORTING

LATCH = 1.0  # s for which a passing event stays reported
HEAD = ("sample", "mode", "command", "measurement", "voltage", "offset")
NEVER = -1.0  # s
AT_REST = tachometer.State(0.0, 0.0)
NO_MOTION = points.Motion(0.0, 0.0, 0.0)
F = TypeVar("F", bound=Callable[..., Any])
COUNTS = (
    "lvdt_lost", "lvdt_refused", "command_refused", "command_limited", "saturated", "assumption_violations",
    "law_not_finite", "safe_stops",
)  # fmt: skip


class Mode(IntEnum):
    """Whether the law has the valve."""

    OK = 0
    DEGRADED = 1
    SAFE = 2


class Reported(NamedTuple):
    """The reported sentences and events; both dictionaries are replaced, never changed in place."""

    texts: dict[str, str]  # sentence by name, in the order in which they came
    expiry: dict[str, float]  # s, by name, until when a passing event stays reported


@dataclass(slots=True)
class BaseMemory:
    """What ``Memory`` has whatever the table of watches is; a snapshot keeps it up to ``said``."""

    samples: int = 0
    now: float = 0.0  # s  since init
    voltage: float = 0.0  # V
    sequence: int | None = None  # number of the last reading
    judged: lvdt.State = lvdt.NOTHING  # the readings one by one
    response: answer.State = answer.NOTHING  # of the spool to the voltage
    pace: rate.State = rate.UNKNOWN  # their period
    trust: lvdt_trust.State = lvdt_trust.NOTHING  # in the LVDT
    measurement: float = math.nan  # V  last believable reading, none before the first
    velocity: tachometer.State = AT_REST
    evidence: plausibility.State | None = None  # whether readings answer the voltage
    command: command_watch.State = command_watch.NOTHING
    used: float | None = None  # V  the command at the sample before, without offset
    effective: float = math.nan  # V  the same, as the law got it, none before the first
    transfer: bumpless_transfer.State = bumpless_transfer.NOTHING
    course: command_course.State | None = None  # of commands
    trajectory: points.State | None = None  # instead of commands
    clock: float = 0.0  # s  of this process at the last reading, since init
    pulse: clocks.State = clocks.NOTHING  # this clock over ``now``
    sender: clocks.State = clocks.NOTHING  # the same over the time stamps of commands
    lead: command_lead.State | None = None  # of the command, none without it or without the law
    law: Any | None = None  # state of the law, none while it does not have the valve
    former: Any | None = None  # state of the law when it had the valve last, none if that is of no use
    proven: Any | None = None  # state of the law when reading and voltage agreed last
    kept: tuple[str, tuple[float, ...] | None] = ("", None)  # law and its estimates before the start
    saturated_for: float = 0.0  # s
    cycle: oscillation.State = oscillation.NOTHING
    swing: oscillation.State = oscillation.NOTHING  # the same, from one limit of the voltage to the other
    probe: lock_in.State = lock_in.NOTHING  # of these cycles
    source: str = ""  # of cycles that go on: oscillation, lvdt_hum, none
    pause: cycle_watch.Pause = cycle_watch.NEVER  # after cycles at the limit of the voltage
    said: Reported = Reported({}, {})
    motion: points.Motion = NO_MOTION  # wanted at this sample
    fading: bool = True  # whether an offset of ``transfer`` may be other than 0
    jumped_until: float = NEVER  # s  until when a jump that was bridged counts, -1: there is none
    name: str = ""  # of the law
    changed: bool = False  # set with each change of the reported conditions, cleared by the reader
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))
    skipped: int = 0  # readings since the last answered one that came while the process stood still


if TYPE_CHECKING:
    Memory = BaseMemory
else:
    Memory = make_dataclass(
        "Memory",
        [(w.slot, w.module.State, w.module.NOTHING) for w in REPORTING],
        bases=(BaseMemory,),
        namespace={"__doc__": "All that is remembered between two samples, beside parameters."},
        slots=True,
    )
    Memory.__module__, Memory.template = __name__, BaseMemory
_NAMES = [one.name for one in fields(BaseMemory)]
_END = _NAMES.index("said")
_REPORTING = tuple((w.slot, w.condition, w.module.step, w.module.text) for w in REPORTING)  # quicker
KEPT = (*_NAMES[:_END], *(w.slot for w in REPORTING), "said")  # by a snapshot


def node_only(function: F) -> F:
    """Mark ``function`` as one whose calls exported C leaves out: it changes nothing that others read."""
    function.node_only = True  # type: ignore[attr-defined]
    return function


@node_only
def report(memory: Memory, name: str, text: str) -> None:
    """Report ``text`` under ``name``, unless something is reported there already."""
    if name not in memory.said.texts:
        memory.said = Reported({**memory.said.texts, name: text}, memory.said.expiry)
        memory.changed = True


@node_only
def clear(memory: Memory, name: str) -> None:
    """Report nothing under ``name`` any more."""
    if name in memory.said.texts:
        texts = {key: text for key, text in memory.said.texts.items() if key != name}
        memory.said = Reported(texts, {key: end for key, end in memory.said.expiry.items() if key != name})
        memory.changed = True


@node_only
def latch(memory: Memory, name: str, text: str, lasting: float = LATCH) -> None:
    """Report an event of this moment for ``lasting`` [s]."""
    report(memory, name, text)
    memory.said = Reported(memory.said.texts, {**memory.said.expiry, name: memory.now + lasting})


@node_only
def expire(memory: Memory) -> None:
    """Report those events no more that are over."""
    for name, end in memory.said.expiry.items():
        if memory.now > end:
            clear(memory, name)


@node_only
def count(memory: Memory, name: str) -> None:
    """Count one more event."""
    memory.counts[name] += 1


@node_only
def forget_saturation(memory: Memory) -> None:
    """Drop what the voltages until now have shown of saturation."""
    memory.saturated_for = 0.0
    clear(memory, "saturation")


@node_only
def step_watches(p: Any, memory: Memory, block: plausibility.Block) -> None:
    """Let the watches that only report look at a block; ``p``: Params of the watches beside the check."""
    for slot, name, step, text in _REPORTING:
        params = getattr(p, slot)
        state = step(params, getattr(memory, slot), block)
        setattr(memory, slot, state)
        told = text(params, state)
        if told == "":
            clear(memory, name)
        else:
            report(memory, name, told)


@node_only
def stop_watches(memory: Memory) -> None:
    """The voltage is switched off."""
    for watch in REPORTING:
        setattr(memory, watch.slot, watch.stopped(getattr(memory, watch.slot)))


@node_only
def forget_watches(memory: Memory, entirely: bool = False) -> None:
    """Drop what the watches that only report have learnt of the valve.

    ``entirely``: all that they have, since there is no plausibility check any more, on which they depend.
    """
    for watch in REPORTING:
        before = getattr(memory, watch.slot)
        after = watch.module.NOTHING if entirely else watch.forgotten(before)
        if after is not before:
            setattr(memory, watch.slot, after)
            clear(memory, watch.condition)
