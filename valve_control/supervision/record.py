"""Holds all that a supervisor remembers between two samples as one record, with the values read from it."""

import math
from collections.abc import Sequence
from difflib import get_close_matches
from enum import IntEnum
from typing import Any, NamedTuple

from valve_control.laws import command_lead, velocity
from valve_control.laws.law import Law
from valve_control.laws.projection import clip
from valve_control.laws.registry import LAWS
from valve_control.parameter import ParameterError, Values, one_of
from valve_control.supervision import (
    bumpless_transfer,
    command_course,
    command_watch,
    conditions,
    lvdt,
    lvdt_watch,
    oscillation,
    plausibility,
    rate,
    trajectory,
)

Conditions = conditions.State
HEAD = ("sample", "mode", "command", "measurement", "voltage", "offset")


def named_terms(names: Sequence[str]) -> tuple[str, ...]:
    """``names`` of terms of ~/state, each once. Raises ParameterError for one that no law has."""
    known = sorted({*HEAD, *(label for law in LAWS.values() for label in law.term_labels)})
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=2)
            hint = f"did you mean {one_of(near)}?" if near else f"they are {', '.join(known)}"
            raise ParameterError(f"state_topics has '{name}', which is no term of any law; {hint}")
    return tuple(dict.fromkeys(names))


COUNTS = (
    "lvdt_lost", "lvdt_refused", "command_refused", "command_limited", "saturated", "assumption_violations",
    "law_not_finite", "safe_stops",
)  # fmt: skip


class Mode(IntEnum):
    """Whether the law has the valve."""

    OK = 0
    DEGRADED = 1
    SAFE = 2


class State(NamedTuple):
    """Everything that is remembered between two samples, beside parameters and counters."""

    samples: int
    now: float  # s
    voltage: float  # V
    sequence: int | None  # number of the last reading
    judged: lvdt.State  # the readings one by one
    pace: rate.State  # their period
    trust: lvdt_watch.State  # in the LVDT
    measurement: float  # V  last believable reading, NaN before the first
    velocity: velocity.State
    evidence: plausibility.State | None  # whether readings answer the voltage
    command: command_watch.State
    used: float | None  # V  the command at the sample before, without offset
    effective: float  # V  the same, as the law got it, NaN before the first
    transfer: bumpless_transfer.State
    course: command_course.State | None  # of commands that are joined
    trajectory: trajectory.State | None  # instead of commands
    lead: command_lead.State | None  # of the command, None without it or without the law
    law: Any  # state of the law, None while it does not have the valve
    former: Any  # state of the law that had the valve last, None if that is of no use
    kept: tuple[str, tuple[float, ...] | None]  # law and its estimates before the start
    saturated_for: float  # s
    cycle: oscillation.State
    said: Conditions


def at_rest(samples: int, kept: tuple[str, tuple[float, ...] | None]) -> State:
    """State after switching on."""
    return State(
        samples, 0.0, 0.0, None, lvdt.NOTHING, rate.UNKNOWN, lvdt_watch.NOTHING, math.nan,
        velocity.State(0.0, 0.0), None, command_watch.NOTHING, None, math.nan, bumpless_transfer.NOTHING,
        None, None, None, None, None, kept, 0.0, oscillation.NOTHING, conditions.NOTHING,
    )  # fmt: skip


class Record:
    """What a supervisor remembers, field by field, since only some of it changes with each sample."""

    def __init__(self) -> None:
        self.name = ""  # of the law
        self.values: Values = {}  # in use
        self.changed = False  # set with each change of the reported conditions, cleared by the reader
        self.counts = dict.fromkeys(COUNTS, 0)
        self._descriptor: Law | None = None
        self._law: Any = None  # its module
        self._params: Any = None
        self._terms: tuple[float, ...] = ()  # of the law at the last sample
        self._watched: tuple[int, str] | None = None  # of them, and what is said if the next is below it
        self.state = at_rest(0, ("", None))

    @property
    def state(self) -> State:
        """All that is remembered, as one record, from which another supervisor goes on bit for bit."""
        return State(
            self.samples, self._now, self.voltage, self._sequence, self._judged, self._pace, self._trust,
            self._measurement, self._velocity, self._evidence, self._command, self._used, self._effective,
            self._transfer, self._course, self._trajectory, self._lead, self._state, self._former, self._kept,
            self._saturated_for, self._cycle, self._said,
        )  # fmt: skip

    @state.setter
    def state(self, state: State) -> None:
        (
            self.samples, self._now, self.voltage, self._sequence, self._judged, self._pace, self._trust,
            self._measurement, self._velocity, self._evidence, self._command, self._used, self._effective,
            self._transfer, self._course, self._trajectory, self._lead, self._state, self._former, self._kept,
            self._saturated_for, self._cycle, self._said,
        ) = state  # fmt: skip

    @property
    def conditions(self) -> dict[str, str]:
        """All reported conditions: sentences by name."""
        return self._said.texts

    @property
    def mode(self) -> Mode:
        """Present mode."""
        if self._trust.blocked or "lvdt_missing" in self.conditions:
            return Mode.SAFE
        return Mode.DEGRADED if self.conditions else Mode.OK

    @property
    def reason(self) -> str:
        """All reported conditions in one line."""
        return "; ".join(self.conditions.values()) or "controlling"

    @property
    def command_in_force(self) -> float | None:
        """Command [V] in force, None before the first."""
        return self._command.value

    @property
    def joins(self) -> bool:
        """Whether the time between two commands counts."""
        return self.values["command.interpolation"] != "hold"

    @property
    def has_trajectory(self) -> bool:
        """Whether the command is a trajectory's."""
        return self._trajectory is not None

    @property
    def command_left(self) -> bool:
        """Whether the upper level has left, and no command has come since."""
        return self._command.gone_since is not None

    @property
    def measurement(self) -> float:
        """The last believable reading [V], NaN before the first."""
        return self._measurement

    @property
    def bridged(self) -> int:
        """Number of consecutive readings that could not be believed and are being bridged."""
        return 0 if self._trust.blocked else self._trust.bridged

    @property
    def begun(self) -> bool:
        """Whether a believable reading has come since the start."""
        return "lvdt_missing" not in self.conditions

    @property
    def theta(self) -> tuple[float, ...] | None:
        """Present estimates of a law that adapts, else None."""
        state = self._state if self._state is not None else self._former
        if state is None or "theta" not in state._fields or "theta_min" not in self._params._fields:
            return None
        return tuple(map(clip, state.theta, self._params.theta_min, self._params.theta_max))

    @property
    def assumed(self) -> dict[str, float]:
        """What the law's assumptions bound, and that bound, at the last sample; {} if they bound nothing."""
        if self._watched is None or not self._terms:
            return {}
        at = self._watched[0]
        fields = self._law.Terms._fields
        return {fields[i]: self._terms[i] for i in (at, at + 1)}

    def labels(self) -> tuple[str, ...]:
        """Names of the numbers of ``telemetry``."""
        return (*HEAD, *self._law.Terms._fields)

    def telemetry(self) -> list[float]:
        """Numbers of this sample; the law's terms are NaN while it does not have the valve."""
        terms = self._terms or (math.nan,) * len(self._law.Terms._fields)
        return [
            float(self.samples),
            float(self.mode),
            self._effective,
            self._measurement,
            self.voltage,
            self._transfer.voltage.value,
            *terms,
        ]

    def present_values(self) -> Values:
        """The parameters in use, with the present estimates as the initial ones of the running law."""
        values = dict(self.values)
        theta = self.theta or (self._kept[1] if self._kept[0] == self.name else None)
        if theta is not None:
            values[f"{self.name}.theta_initial"] = list(theta)
        return values

    # What is reported

    def _tell(self, said: Conditions) -> None:
        if said.texts is not self._said.texts:
            self.changed = True
        self._said = said

    def _report(self, name: str, text: str) -> None:
        self._tell(conditions.report(self._said, name, text))

    def _clear(self, name: str) -> None:
        self._tell(conditions.clear(self._said, name))

    def _latch(self, name: str, text: str) -> None:
        self._tell(conditions.latch(self._said, name, text, self._now))
