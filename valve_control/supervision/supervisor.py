"""Runs one law: rejects implausible readings, bridges gaps, forces 0 V on faults, swaps laws without a bump.

Three modes:

ok        the law has the valve;
degraded  the law has the valve, but something is reported: a silent or refused command, bridged readings,
          long saturation, a limit cycle, a broken assumption, a second publisher;
safe      0 V, the spring centres the spool: the LVDT cannot be believed, or the law left the finite numbers.

It is put together from parts in the form of a law, pure functions on a state: the watches over the LVDT
(lvdt_watch.py), the command (command_watch.py) and the law (law_watch.py), the takeover between laws
(bumpless_transfer.py), and what is reported (conditions.py). All that it remembers is one record (record.py);
law_in_force.py steps the law.

Time is counted in samples, so that a run is repeatable; only the silence of the LVDT, during which no sample
comes, has to be told from outside (``silence``).
"""

import math
from collections.abc import Callable
from typing import Any

from valve_control.laws import velocity
from valve_control.parameter import Values, number
from valve_control.plant.amplifier import saturate
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
from valve_control.supervision.law_in_force import LawInForce, unused
from valve_control.supervision.record import at_rest

BOTH = "spool_command is ignored while spool_trajectory commands"
PATIENCE = 0.5  # s without a point after which commands are taken again, where silence is none that is missed


class Supervisor(LawInForce):
    """Controls one valve: takes readings and commands, returns voltages, and reports conditions."""

    def __init__(self) -> None:
        super().__init__()
        self.answered = True  # whether the readings are those of a valve that gets these voltages
        self._watch_lvdt: lvdt_watch.Params  # from apply on
        self.start()

    # Life

    def start(self) -> None:
        """Begin at rest with 0 V, as after switching on; parameters and counters are kept."""
        theta = self.theta
        self.state = at_rest(self.samples, self._kept if theta is None else (self.name, theta))
        self._terms = ()
        self._report("lvdt_missing", "no LVDT reading yet")

    def apply(self, values: Values, params: Any) -> None:
        """Take checked ``values`` and the law's ``params`` built from them into use, between two samples."""
        watch = lvdt_watch.design(values, params)
        self._limited = params
        if watch.comparison is not None:
            limit = lvdt_watch.PROBATION * number(values, "lvdt.disturbance")
            self._limited = params._replace(u_max=min(number(values, "u_max"), limit))
        if self._form and watch.comparison != self._watch_lvdt.comparison:
            self._evidence = None
        if self._form and watch.period != self._watch_lvdt.period:
            self._pace = rate.UNKNOWN
            self._clear("lvdt_rate")
        self._watch_lvdt = watch
        self._use(values, params)

    def reset(self) -> None:
        """Set estimates and filters to their start, without a bump; doubts about the LVDT are dropped."""
        self._end_doubt()
        self._former = None
        self._kept = ("", None)
        if self._state is not None:
            self._take_over(None, following=True)

    # Inputs

    def command(self, value: float, interval: float = 0.0) -> None:
        """Take in a command [V] from the upper level.

        ``interval`` [s]: by which it was sent after the one before, if that is known.
        """
        if not math.isfinite(value):
            self._command = command_watch.taken(self._watch_command, self._command, value, self._now)
            self._refuse_command(f"command {value} refused, the last one holds")
            return
        if self._follows_trajectory():
            self._latch("command_both", BOTH)
            return
        self._trajectory = None
        if self._joining is not None:
            arrival = self._now + self._joining.period
            limited = saturate(value, self._joining.limit)
            self._course = command_course.taken(self._joining, self._course, limited, interval, arrival)
        self._renew(value)

    def trajectory(self, point: trajectory.Motion, interval: float = 0.0) -> bool:
        """Take in a point of a trajectory from the upper level; whether it can be used.

        ``interval`` [s]: by which its time stamp is after that of the one before, 0 if that is not known.
        A trajectory has precedence over commands for as long as it is not silent.
        """
        follows = self._follows_trajectory()
        fault = trajectory.fault(point, -interval if follows else 0.0)
        if fault:
            self._refuse_command(fault)
            return False
        arrival = self._now + self._watch_command.period
        before = self._trajectory if follows else None
        self._trajectory = trajectory.taken(before, point, interval, arrival, self._watch_command.period)
        self._course = None
        self._renew(point.position)
        return True

    def trajectory_refused(self, positions: int, velocities: int, accelerations: int) -> None:
        """A point of a trajectory came with so many entries."""
        self._refuse_command(trajectory.refusal(positions, velocities, accelerations))

    def trajectory_gone(self) -> None:
        """Who sent the trajectory has left, others have not: commands are taken again."""
        self._trajectory = None

    def command_gone(self) -> None:
        """Report that the upper level has left: its command counts as silent at once."""
        self._command = command_watch.left(self._command, self._now)

    def _follows_trajectory(self) -> bool:
        """Whether there is a trajectory that is not silent."""
        if self._trajectory is None or self.command_left:
            return False
        patience = self._watch_command.timeout or PATIENCE
        return self._now <= self._trajectory.arrival + patience

    def _renew(self, value: float) -> None:
        """The upper level has spoken: its command [V] counts from the next sample on."""
        taken = self._command = command_watch.taken(self._watch_command, self._command, value, self._now)
        if "command_missing" in self._said.texts:
            self._clear("command_missing")
        if taken.value != value:
            self.counts["command_limited"] += 1
            self._latch("command_limited", f"command {value:g} V limited to {taken.value:g} V")

    def _refuse_command(self, text: str) -> None:
        self.counts["command_refused"] += 1
        self._latch("command_refused", text)

    def observe(self, name: str, text: str) -> None:
        """Report ``text`` under ``name``, a condition seen from outside; "" ends it."""
        if text != self.conditions.get(name, ""):
            self._clear(name)
            if text:
                self._report(name, text)

    def silence(self, elapsed: float, stalled: bool = False) -> float:
        """Report that no reading was answered for too long; returns the voltage [V].

        ``elapsed`` [s]: since the last reading or the last call; ``stalled``: readings have come, but this
        process stood still.
        """
        self._now += elapsed
        self._pace = rate.interrupted(self._pace)
        self._trust = self._trust._replace(sound=0)
        if not self._trust.blocked and self._state is not None:
            limit = f"for more than {self._watch_lvdt.hold_samples} samples"
            leapt = self._leapt()
            if stalled:
                self._switch_off("stalled", f"the controller's process stood still {limit}", leapt)
            else:
                self._switch_off("lvdt_silent", f"{lvdt.TEXTS['silent']} {limit}", leapt)
        return self.voltage

    def sample(
        self,
        reading: float,
        sequence: int | None = None,
        elapsed: float = 0.0,
        give: Callable[[float], None] = unused,
    ) -> float:
        """Answer one LVDT reading [V]; returns the voltage [V] to apply until the next one.

        ``sequence``: number of the reading, from which lost ones are known; ``elapsed`` [s]: real time since
        the one before, if it is known: the spool may have moved that long. ``give`` gets the voltage too,
        once, as soon as it is certain: before what only the next sample needs. It must not raise.
        """
        self._give = give
        voltage = self._judge(reading, sequence, elapsed)
        self._hand_out(voltage)
        return voltage

    # The way from reading to voltage

    def _judge(self, reading: float, sequence: int | None, elapsed: float) -> float:
        """Believe the reading and control, or bridge it, or keep the voltage off."""
        assert self._form, "apply comes first"
        p, trust, last = self._watch_lvdt, self._trust, self._sequence
        lost, self._sequence = 0, sequence
        if sequence is not None and last is not None and sequence > last + 1:
            lost = 0 if "lvdt_publishers" in self.conditions else sequence - last - 1
            self.counts["lvdt_lost"] += lost
        self.samples += 1
        # A longer gap is a silence, whose time is told there.
        self._now += (1 + min(lost, p.hold_samples)) * p.period
        if self._said.expiry:
            self._tell(conditions.step(self._said, self._now))
        pace = rate.step(p.pace, self._pace, elapsed, 1 + lost)
        changed, self._pace = pace.level != self._pace.level, pace
        if changed:
            self._clear("lvdt_rate")
            if pace.level == 1:
                self._report("lvdt_rate", rate.text(p.pace, pace))
        blocked = trust.blocked != ""
        fault, self._judged = lvdt.step(p.judge, self._judged, reading, lost, self.voltage, blocked, elapsed)
        if fault:
            self._refuse(p, fault, lost)
            return self.voltage
        gap = lost + trust.bridged
        if gap:
            self._bridge(p, gap, reading)
        if pace.level == 2 and not self._trust.blocked:
            self._switch_off("lvdt_period", rate.text(p.pace, pace))
        applied = self.voltage
        if self._trust.blocked and not self._recovered(p, reading, gap > 0 or pace.level == 2):
            self._evidence = lvdt_watch.weighed(p.comparison, self._evidence, reading, applied, 1 + gap)
            return applied
        if self._state is None:
            self._begin(reading)
        if not self._control(reading):
            self._leave_the_finite()
        voltage = self.voltage
        self._measurement = reading
        self._velocity = velocity.step(p.tachometer, self._velocity, reading)
        self._evidence = lvdt_watch.weighed(p.comparison, self._evidence, reading, applied, 1 + gap)
        if self._evidence is not None and self._evidence.held == 0.0:
            self._confront(p, self._evidence)
        return voltage

    def _refuse(self, p: lvdt_watch.Params, fault: str, lost: int) -> None:
        """Bridge a reading that cannot be believed, or switch off if there have been too many."""
        self.counts["lvdt_refused"] += 1
        self._trust = lvdt_watch.refused(self._trust, lost)
        if self._trust.blocked:
            return
        if fault == "frozen" or self._trust.bridged > p.hold_samples:
            self._switch_off(f"lvdt_{fault}", lvdt.TEXTS[fault])
        else:
            self._latch(f"lvdt_{fault}_bridged", f"{lvdt.TEXTS[fault]}: bridged")

    def _bridge(self, p: lvdt_watch.Params, gap: int, reading: float) -> None:
        """Step the law over ``gap`` samples before a sound reading, or switch off."""
        leapt = self._leapt()
        self._trust = self._trust._replace(bridged=0)
        if self._trust.blocked or self._state is None:
            return
        if gap > p.hold_samples:
            self._switch_off("lvdt_silent", f"{gap} LVDT readings lost in a row", leapt)
            return
        self._latch("lvdt_bridged", "LVDT readings lost: bridged")
        if not self._step_over(gap, reading, p.tachometer):
            self._leave_the_finite()

    def _leapt(self) -> bool:
        """Whether readings that are being bridged leapt: after a gap they would be taken for motion."""
        return self._trust.bridged > 0 and "lvdt_jump_bridged" in self.conditions

    def _confront(self, p: lvdt_watch.Params, evidence: plausibility.State) -> None:
        """Report what readings and voltage have shown together with this block."""
        if p.comparison is None or self._trust.blocked or not self.answered:
            return
        found, doubt = plausibility.finding(p.comparison, evidence, self._trust.doubt)
        if found:
            self._switch_off("lvdt_disagrees", f"{lvdt.TEXTS['disagrees']}: {found}")
        elif doubt is not self._trust.doubt:
            self._end_doubt()

    def _end_doubt(self) -> None:
        self._trust = self._trust._replace(doubt=plausibility.TRUST)
        self._clear("lvdt_doubted")

    # Off and on again

    def _leave_the_finite(self) -> None:
        self.counts["law_not_finite"] += 1
        self._switch_off("law_not_finite", f"{self.name} left the finite numbers")
        self._former = None

    def _switch_off(self, name: str, text: str, leapt: bool = False) -> None:
        doubt = self._trust.doubt
        self._trust = lvdt_watch.switched_off(
            self._watch_lvdt, self._trust, self._evidence, name, self._now, self.answered, leapt
        )
        if self._trust.doubt is not doubt:
            self._clear("lvdt_doubted")
        self._report(name, text)
        self.counts["safe_stops"] += 1
        self.voltage = 0.0
        self._former, self._state = self._state, None
        self._terms = ()
        self._transfer = bumpless_transfer.NOTHING
        self._lead = None
        self._cycle = oscillation.NOTHING  # switching on and off is no limit cycle of law and valve
        self._saturated_for = 0.0
        self._clear("saturation")

    def _recovered(self, p: lvdt_watch.Params, reading: float, anew: bool) -> bool:
        """Whether enough sound readings have come and the spool is at rest; the law is then back in force."""
        name = self._trust.blocked
        motion = lvdt_watch.Motion(self._measurement, self._velocity, self._evidence)
        self._trust, motion = lvdt_watch.recovered(p, self._trust, motion, reading, anew, self._now)
        self._measurement, self._velocity, self._evidence = motion
        if self._trust.blocked:
            return False
        self._clear(name)
        if self._trust.doubt.times > 0.0:
            self._report("lvdt_doubted", lvdt.TEXTS["doubted"])
        self._welcome(reading)
        self._take_over(self._former)
        return True
