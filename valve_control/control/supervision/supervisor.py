# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs one law: rejects implausible readings, bridges gaps, forces 0 V on faults, swaps laws without a bump.

Three modes:

ok        the law has the valve;
degraded  the law has the valve, but something is reported: a silent or refused command, bridged readings,
          long saturation, a limit cycle, a broken assumption, a second publisher;
safe      0 V: the LVDT is implausible, the law gave NaN or infinity, or even cycles reach ±u_max.

The steps are in control_step.py, functions on one memory (memory.py), from which exported C is made too;
binding.py puts the functions of the law into them. Here is what only a node has: other laws and parameters,
the period of the readings, counters and telemetry.

Time is counted in samples, so that a run is repeatable; only the silence of the LVDT, during which no sample
comes, has to be told from outside (``silence``). Each input is noted with its answer (journal.py).
"""

import math
import types
from collections.abc import Callable
from typing import Any

from valve_control.control.laws import linearisation
from valve_control.control.laws.law import Law
from valve_control.control.laws.projection import clip
from valve_control.control.laws.registry import LAWS
from valve_control.control.plant.saturation import saturate
from valve_control.control.supervision import (
    binding,
    bumpless_transfer,
    control_step,
    law_watch,
    lock_in,
    oscillation,
    rate,
)
from valve_control.control.supervision import trajectory as points
from valve_control.control.supervision.journal import OBSERVED, TYPES, Event
from valve_control.control.supervision.memory import (
    HEAD,
    Memory,
    Mode,
    clear,
    count,
    forget_watches,
    latch,
    report,
)
from valve_control.parameter import Values, number, word


def unused(*values: Any, **named: Any) -> None:
    """Placeholder for a receiver of the voltage or of rows, where nobody needs them."""


class Supervisor:
    """Controls one valve: takes readings and commands, returns voltages, and reports conditions.

    ``note`` gets each input with its answer, as ``Journal.note`` has it.
    """

    def __init__(self, note: Callable[..., None] = unused) -> None:
        self.name = ""  # of the law
        self.values: Values = {}  # in use
        self.memory = Memory()
        self.answered = True  # whether the valve of the readings gets these voltages; counts from apply on
        self._form: tuple[Any, ...] = ()  # after whose change the law's state means something else
        self._descriptor: Law | None = None
        self._bounded: tuple[int, str] | None = None  # of the terms, and what is said if the next is below it
        self._terms: tuple[float, ...] = ()  # of the law at the last sample
        self._give: Callable[..., None] = unused
        self._note: Callable[..., None] = unused
        self.params: control_step.Params  # these four from apply on
        self._saturation_limit: float  # s
        self._steps: types.SimpleNamespace
        self._sample: Callable[..., float]
        self._rest()
        self._note = note

    # Life

    def start(self) -> None:
        """Begin at rest with 0 V, as after switching on; parameters and counters are kept."""
        self._rest()
        self._note(Event.START)

    def stop(self) -> float:
        """Go to rest; returns 0 V."""
        self._rest()
        self._note(Event.STOP, voltage=0.0)
        return 0.0

    def _rest(self) -> None:
        before, theta = self.memory, self.theta
        kept = before.kept if theta is None else (self.name, theta)
        self.memory = Memory(samples=before.samples, kept=kept, name=self.name, counts=before.counts)
        report(self.memory, "lvdt_missing", "no LVDT reading yet")

    def apply(self, values: Values, params: Any) -> None:
        """Take checked ``values`` and the law's ``params`` built from them into use, between two samples."""
        memory, made, sent = self.memory, control_step.design(values, params, self.answered), self.voltage
        former = self.params if self._form else None
        self.values, self.params = values, made
        self._saturation_limit = number(values, "saturation_limit")
        curve_changed = former is not None and made.line != former.line
        if former is not None and (made.lvdt.comparison != former.lvdt.comparison or curve_changed):
            memory.evidence = None
            forget_watches(memory, made.lvdt.comparison is None)
        if former is not None and made.lvdt.period != former.lvdt.period:
            memory.pace = rate.UNKNOWN._replace(means=memory.pace.means)
            clear(memory, "lvdt_rate")
        lead = None if former is None else former.lead
        if lead is None or made.lead is None or lead.period != made.lead.period:
            memory.lead = None
        if curve_changed:  # the law's voltage has another unit, and its estimates are those of another valve
            memory.voltage = linearisation.given(values, sent)
            control_step.end_doubt(memory)
            memory.cycle = memory.swing = oscillation.NOTHING
            memory.probe = lock_in.NOTHING
            memory.former, memory.kept = None, ("", None)
        memory.voltage = saturate(memory.voltage, params.u_max)
        if memory.command.value is not None:
            memory.command = memory.command._replace(value=saturate(memory.command.value, made.command.limit))
        self._use_law(values, params, None if former is None else former.law)
        self._note(Event.PARAMETERS)

    def _use_law(self, values: Values, params: Any, former: Any) -> None:
        """Let another law, or another form of it, take over from the one with the params ``former``."""
        memory, name = self.memory, word(values, "controller")
        line = self.params.line
        form = (name, number(values, "sample_period"), line, *(values[key] for key in LAWS[name].form))
        estimates = getattr(params, "theta_initial", None)
        anew = form[0] == self.name and estimates != getattr(former, "theta_initial", None)
        if anew and memory.law is None:
            memory.former = None
        if form == self._form and not anew:
            return
        before, law = self._descriptor, LAWS[name]
        another_curve = bool(self._form) and line != self._form[2]
        same_reference = before is not None and before.reshapes(former)
        if law is not before or line != self._form[2]:
            receivers = {"give_voltage": self._give_once, "observe": self._watch_law}
            self._steps = binding.with_places({**binding.places_of(law, line), **receivers})
            self._sample = self._steps.sample
        self._descriptor = law
        self._form = form
        self.name = memory.name = name
        self._bounded = law_watch.bounded_term(law.module.Terms._fields)
        self._terms = ()
        if memory.law is None:
            return
        if another_curve:
            self._steps.take_over(self.params, memory, None, True)
            return
        begun = memory.law._replace(theta=estimates) if anew else memory.law
        if same_reference and law.reshapes(params):
            self._steps.go_on(self.params, memory, begun, bumpless_transfer.followed(former, begun))
        else:
            self._steps.take_over(self.params, memory, begun, True)

    def period_refusal(self, period: float) -> str:
        """One sentence why ``period`` [s] cannot become the sample period now, "" if it can."""
        if not self._form or period == self.params.lvdt.period:
            return ""
        return rate.refusal(self.params.lvdt.pace, self.memory.pace, period)

    def reset(self) -> None:
        """Set estimates and filters to their start, without a bump; doubts about the LVDT are dropped."""
        self.memory.kept = ("", None)
        if self._form:
            self._steps.reset(self.params, self.memory)
        self._note(Event.RESET)

    # Inputs

    def command(self, value: float, stamp: float = math.nan, since: float = 0.0) -> None:
        """Take in a command [V] from the upper level.

        ``stamp`` [s]: when it was sent, by the sender's clock, NaN: unknown, it is that of the next sample.
        ``since`` [s]: how long after the last call of ``sample``, ``silence`` or ``skip`` it came.
        """
        control_step.command(self.params, self.memory, float(value), stamp, since)
        self._note(Event.COMMAND, stamp, since, command=value)

    def trajectory(self, point: points.Motion, stamp: float = math.nan, since: float = 0.0) -> bool:
        """Take in a point of a trajectory from the upper level; whether it can be used.

        ``stamp``, ``since``: as of ``command``. A trajectory has precedence over commands for as long as it
        is not silent.
        """
        taken = control_step.trajectory(self.params, self.memory, point, stamp, since)
        times = (0.0, math.nan) if math.isnan(stamp) else (stamp, since)
        self._note(Event.TRAJECTORY, point.velocity, point.acceleration, *times, command=point.position)
        return taken

    def trajectory_refused(self, positions: int, velocities: int, accelerations: int) -> None:
        """A point of a trajectory came with so many entries."""
        count(self.memory, "command_refused")
        latch(self.memory, "command_refused", points.refusal(positions, velocities, accelerations))
        row = Event.TRAJECTORY_REFUSED, float(velocities), float(accelerations)
        self._note(*row, command=float(positions))

    def trajectory_gone(self) -> None:
        """Who sent the trajectory has left, others have not: commands are taken again."""
        if self.memory.trajectory is not None:
            control_step.trajectory_gone(self.memory)
            self._note(Event.TRAJECTORY_GONE)

    def command_gone(self) -> None:
        """Report that the upper level has left: its command counts as silent at once."""
        if self.memory.command.gone_since is None:
            control_step.command_gone(self.memory)
            self._note(Event.COMMAND_GONE)

    def observe(self, name: str, text: str) -> bool:
        """Report ``text`` under ``name``, a condition seen from outside; "" ends it. Whether that is new."""
        if text == self.conditions.get(name, ""):
            return False
        clear(self.memory, name)
        if text:
            report(self.memory, name, text)
        return True

    def publishers(self, topic: str, count: int) -> None:
        """Report how many publishers ``topic``, one of OBSERVED, has; -n: n have another message type."""
        event, name = OBSERVED[topic]
        text = f"{count} publishers on {topic}" if count > 1 else ""
        if count < 0:
            text = f"{-count} of the publishers on {topic} have another message type than {TYPES[topic]}"
        if self.observe(name, text):
            self._note(event, number=count if text else 0)

    def silence(self, elapsed: float, stalled: bool = False) -> float:
        """Report that no reading was answered for too long; returns the voltage [V].

        ``elapsed`` [s]: since the last reading or the last call; ``stalled``: readings have come, but this
        process stood still.
        """
        voltage = self._silence(elapsed, stalled)
        event = Event.STALL if stalled else Event.SILENCE
        self._note(event, elapsed=elapsed, voltage=voltage if self.begun else math.nan)
        return voltage

    def skip(self, reading: float, number: float, elapsed: float) -> float:
        """A ``reading`` has come while this process stood still, and is stale; returns the voltage [V]."""
        self.memory.skipped += 1
        voltage = self._silence(elapsed, True)
        self._note(Event.STALL, reading, number, elapsed, voltage)
        return voltage

    def _silence(self, elapsed: float, stalled: bool) -> float:
        self.memory.pace = rate.interrupted(self.memory.pace)
        return control_step.silence(self.params, self.memory, elapsed, stalled)

    def sample(
        self,
        reading: float,
        sequence: int | None = None,
        elapsed: float = 0.0,
        give: Callable[..., None] = unused,
    ) -> float:
        """Answer one LVDT reading [V]; returns the voltage [V] to apply until the next one.

        ``sequence``: number of the reading, from which lost ones are known; ``elapsed`` [s]: real time since
        the one before, if it is known: the spool may have moved that long. ``give`` gets the voltage too,
        once, as soon as it is certain: before what only the next sample needs. It must not raise.
        """
        assert self._form, "apply comes first"
        memory, p = self.memory, self.params
        self._give = give
        lost, last, memory.sequence = 0, memory.sequence, sequence
        if sequence is not None and last is not None and sequence > last + 1:
            lost = 0 if "lvdt_publishers" in memory.said.texts else sequence - last - 1
            memory.counts["lvdt_lost"] += max(0, lost - memory.skipped)
        memory.skipped = 0
        memory.samples += 1
        pace = rate.step(p.lvdt.pace, memory.pace, elapsed, 1 + lost)
        changed, memory.pace = pace.level != memory.pace.level, pace
        if changed:
            clear(memory, "lvdt_rate")
            if pace.level == 1:
                report(memory, "lvdt_rate", rate.text(p.lvdt.pace, pace))
        voltage = self._sample(p, memory, reading, lost, elapsed, pace.level == 2)  # control_step.sample
        self._give_once(voltage)
        self._note(Event.READING, reading, sequence, elapsed, voltage)
        return voltage

    def _give_once(self, voltage: float) -> None:
        give, self._give = self._give, unused
        give(voltage)

    def _watch_law(self, memory: Memory, terms: Any, voltage: float) -> None:
        """Watch a step of the law for what is only reported."""
        self._terms = terms
        p = self.params
        law_watch.step(memory, voltage, p.law.u_max, p.lvdt.period, self._saturation_limit)
        if self._bounded is not None:
            at, text = self._bounded
            if terms[at] > terms[at + 1]:
                memory.counts["assumption_violations"] += 1
                latch(memory, "assumptions", text)

    # What it says

    @property
    def voltage(self) -> float:
        """Voltage [V] of the amplifier in force."""
        return float(self._steps.voltage_in_force(self.params, self.memory)) if self._form else 0.0

    @property
    def conditions(self) -> dict[str, str]:
        """All reported conditions: sentences by name."""
        return self.memory.said.texts

    @property
    def mode(self) -> Mode:
        """Present mode."""
        if self.memory.trust.blocked or "lvdt_missing" in self.conditions:
            return Mode.SAFE
        return Mode.DEGRADED if self.conditions else Mode.OK

    @property
    def reason(self) -> str:
        """All reported conditions in one line."""
        return "; ".join(self.conditions.values()) or "controlling"

    @property
    def bridged(self) -> int:
        """Number of consecutive readings that could not be believed and are being bridged."""
        return 0 if self.memory.trust.blocked else self.memory.trust.bridged

    @property
    def begun(self) -> bool:
        """Whether a believable reading has come since the start."""
        return "lvdt_missing" not in self.conditions

    @property
    def theta(self) -> tuple[float, ...] | None:
        """Present estimates of a law that adapts, else None."""
        memory = self.memory
        state: Any = memory.law if memory.law is not None else memory.former
        estimates = getattr(state, "theta", None)
        if estimates is None:
            return None
        law: Any = self.params.law
        kind: Any = type(getattr(law, "theta_initial", None))
        if not isinstance(estimates, kind):  # while the voltage is off, those of another law
            return None
        if not (hasattr(law, "theta_min") and hasattr(law, "theta_max")):  # a plug-in without ranges
            return tuple(estimates)
        return tuple(map(clip, estimates, law.theta_min, law.theta_max))

    @property
    def terms(self) -> tuple[float, ...]:
        """Terms of the law at the last sample, () while it does not have the valve."""
        return self._terms if self.memory.law is not None else ()

    @property
    def assumed(self) -> dict[str, float]:
        """What the law's assumptions bound, and that bound, at the last sample; {} if they bound nothing."""
        terms = self.terms
        if self._bounded is None or not terms:
            return {}
        at, fields = self._bounded[0], self.labels()[len(HEAD) :]
        return {fields[i]: terms[i] for i in (at, at + 1)}

    def labels(self) -> tuple[str, ...]:
        """Names of the numbers of ``telemetry``."""
        assert self._descriptor is not None, "apply comes first"
        return (*HEAD, *self._descriptor.module.Terms._fields)

    def telemetry(self) -> list[float]:
        """Numbers of this sample; the law's terms are NaN while it does not have the valve."""
        memory, given = self.memory, self.memory.command
        terms = self.terms or (math.nan,) * (len(self.labels()) - len(HEAD))
        return [
            float(memory.samples),
            float(self.mode),
            memory.effective if given.value is None or given.homing is not None else given.value,
            memory.measurement,
            self.voltage,
            memory.transfer.voltage.value,
            *terms,
        ]

    def present_values(self) -> Values:
        """The parameters in use, with the present estimates as the initial ones of the running law."""
        values, kept = dict(self.values), self.memory.kept
        theta = self.theta or (kept[1] if kept[0] == self.name else None)
        if theta is not None:
            values[f"{self.name}.theta_initial"] = list(theta)
        return values
