# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Steps one valve from reading to voltage: the supervisor's machine, for nodes, replay and exported C.

All functions work on one ``Memory``, which they change, and on ``Params``, which they do not. binding.py puts
the functions of a law, and of who runs the machine, in the places that are kept for them. The translator of
export/ makes C of the same functions; it leaves out the calls of those that are marked as ``node_only``.
"""

import math
from typing import Any, NamedTuple

from valve_control.control.compiling import in_words
from valve_control.control.laws import command_lead, linearisation, reshaping, velocity
from valve_control.control.laws.places import law_hold, law_initial, law_step
from valve_control.control.laws.projection import Theta, clip
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate
from valve_control.control.supervision import (
    answer,
    bumpless_transfer,
    clock,
    command_course,
    command_watch,
    cycle_watch,
    lock_in,
    lvdt,
    lvdt_trust,
    oscillation,
    plausibility,
    rate,
    watch_table,
)
from valve_control.control.supervision import trajectory as points
from valve_control.control.supervision.record import (
    LATCH,
    NEVER,
    Memory,
    clear,
    count,
    expire,
    forget_reported,
    forget_saturation,
    latch,
    node_only,
    report,
    reported_of,
    stop_reporting,
)
from valve_control.parameter import Values, number, word

BOTH = "spool_command is ignored while spool_trajectory commands"
OVERDUE = 2.5  # periods since the last reading, from which the driver may have stood still
CATCH_UP = 0.25  # of a period for each reading, by which such a time is made up for without a kink
NOISE = 0.25  # of ``lvdt.tolerance``, way of the spool that may be noise
PATIENCE = 0.5  # s without a point after which commands are taken again, where silence is none that is missed


class Params(NamedTuple):
    """A law and what is expected of its inputs."""

    law: Any  # of the law
    command: command_watch.Params
    lvdt: lvdt_trust.Params
    cycles: cycle_watch.Params  # of the voltage
    watches: Any  # of the table, which look at the blocks of the plausibility check; None without it
    lead: command_lead.Params | None  # of the command
    transfer: bumpless_transfer.Params
    course: command_course.Params  # of commands and of trajectories
    reshapes: bool  # whether the law follows a reshaped reference
    probation: float  # V  limit of the voltage while readings are doubted
    lockstep: bool  # whether the law starts as offline, wherever spool and command are
    answered: bool  # whether the readings are those of a valve that gets these voltages
    line: Any  # voltage of the amplifier over that of the law; 0.0: they are the same
    neutral: float  # V  of the law, for 0 V of the amplifier


def design(values: Values, law: Any, answered: bool = True) -> Params:
    """Params from the controller's values and the Params of its ``law``. Raises ParameterError."""
    line = linearisation.inverse(values) if linearisation.is_on(values) else 0.0
    values = linearisation.seen(values)
    kind = LAWS[word(values, "controller")]
    reshaped = kind.reshapes(law)
    least_cycle = number(values, "oscillation_limit") if kind.feedback else 0.0  # else they are the command's
    watched = lvdt_trust.design(values, law)
    probation = lvdt_trust.PROBATION * number(values, "lvdt.disturbance") or math.inf
    return Params(
        law,
        command_watch.design(values),
        watched,
        cycle_watch.Params(
            oscillation.Params(least_cycle, watched.period),
            cycle_watch.between(law.u_max, watched.period),
            cycle_watch.between(min(law.u_max, probation), watched.period),
        ),
        watch_table.design(values, watched.comparison),
        command_lead.build(values, reshaped),
        bumpless_transfer.design(number(values, "transfer_time"), number(values, "sample_period")),
        command_course.design(values),
        reshaped and hasattr(law, "reshaping"),
        lvdt_trust.PROBATION * number(values, "lvdt.disturbance"),
        bool(values["lockstep"]),
        answered,
        line,
        linearisation.given(values, 0.0),
    )


# Places


def law_steady_command(p: Any, start: Start) -> float:
    """Place of the law's ``steady_command``."""
    raise NotImplementedError


def law_resumed(p: Any, former: Any) -> Any:
    """Parameters with which a law starts again, one without estimates; place of others."""
    return p


def law_commanded(p: Any, motion: points.Motion) -> float:
    """Command [V] of a law that does not reshape; place of ``by_motion``."""
    return motion.position


def amplified(p: Params, voltage: float) -> float:
    """Voltage [V] of the amplifier, where that of the law is the same; place of ``linearised``."""
    return voltage


@node_only
def hand_out(voltage: float) -> None:
    """Place of what is done with the voltage [V] as soon as it is certain."""


@node_only
def observe(m: Memory, terms: Any, voltage: float) -> None:
    """Place of what is done with a law's step afterwards."""


def are_finite(voltage: float, terms: Any) -> bool:
    """Whether a law's ``voltage`` [V] and each of its ``terms`` are finite."""
    return math.isfinite(voltage) and all(map(math.isfinite, terms))


def with_estimates(p: Any, former: Any) -> Any:
    """Parameters with which a law starts again from the estimates that it had."""
    return p._replace(theta_initial=Theta(*map(clip, former.theta, p.theta_min, p.theta_max)))


def by_motion(p: Any, motion: points.Motion) -> float:
    """Command [V] with which a law that reshapes follows ``motion``."""
    return reshaping.command_of(p.reshaping, motion.position, motion.velocity, motion.acceleration)


def linearised(p: Params, voltage: float) -> float:
    """Voltage [V] of the amplifier for the ``voltage`` [V] of the law."""
    return linearisation.value(p.line, voltage)


# Inputs


def command(p: Params, m: Memory, value: float, stamp: float, since: float) -> None:
    """Take in a command ``value`` [V], sent at ``stamp`` [s] of its sender's clock.

    It came ``since`` [s] after the last reading. Without one of both (NaN) it is that of the next sample. It
    is limited; one that is not finite is refused, and any while a trajectory commands.
    """
    if not math.isfinite(value):
        m.command = command_watch.taken(p.command, m.command, value, m.now)
        count(m, "command_refused")
        latch(m, "command_refused", f"command {value} refused, the last one holds")
        return
    if follows_trajectory(p, m):
        latch(m, "command_both", BOTH)
        return
    m.trajectory = None
    sent = sent_at(p, m, stamp, since)
    before = m.course if m.command.homing is None else None
    limited = saturate(value, p.course.limit)
    m.course = command_course.taken(p.course, before, limited, sent, stamp if math.isfinite(stamp) else sent)
    renew(p, m, value)


def sent_at(p: Params, m: Memory, stamp: float, since: float) -> float:
    """When [s] on the clock of the samples a message was sent; ``stamp`` and ``since`` as of ``command``.

    Readings tell how the clock of this process and that of the samples differ, messages that of the sender.
    """
    if not (math.isfinite(stamp) and math.isfinite(since)):
        return m.now + p.course.period
    came = m.clock + since
    m.sender = clock.step(m.sender, came, came - stamp)
    return stamp + clock.offset(m.sender) - clock.offset(m.pulse)


def trajectory(p: Params, m: Memory, point: points.Motion, stamp: float, since: float) -> bool:
    """Take in a ``point`` of a trajectory; whether it can be used. Times as of ``command``."""
    follows = follows_trajectory(p, m)
    before = m.trajectory if follows else None
    arrival = m.now + p.course.period
    backwards = points.backwards(p.course, before, stamp, arrival)
    if not points.usable(point, backwards):
        count(m, "command_refused")
        latch(m, "command_refused", points.fault(point, backwards))
        return False
    sent = sent_at(p, m, stamp, since)
    time = stamp if math.isfinite(stamp) else sent
    m.trajectory = points.taken(p.course, before, point, sent, time, arrival)
    m.course = None
    renew(p, m, point.position)
    return True


def trajectory_gone(m: Memory) -> None:
    """Take commands again: the sender of the trajectory has left."""
    m.trajectory = None


def command_gone(m: Memory) -> None:
    """Count the command as silent at once: the upper level has left."""
    if m.command.gone_since is None:
        m.command = m.command._replace(gone_since=m.now)


def follows_trajectory(p: Params, m: Memory) -> bool:
    """Whether there is a trajectory that is not silent."""
    if m.trajectory is None or m.command.gone_since is not None:
        return False
    patience = PATIENCE if p.command.timeout == 0.0 else p.command.timeout
    return m.now <= m.trajectory.arrival + patience


def renew(p: Params, m: Memory, value: float) -> None:
    """The upper level has spoken: its command ``value`` [V] counts from the next sample on."""
    m.command = command_watch.taken(p.command, m.command, value, m.now)
    clear(m, "command_missing")
    if m.command.value != value:
        count(m, "command_limited")
        latch(m, "command_limited", f"command {value:g} V limited to {m.command.value:g} V")


def silence(p: Params, m: Memory, elapsed: float, stalled: bool) -> float:
    """Switch off after ``elapsed`` [s] without a reading, too long to be bridged; returns the voltage [V].

    ``stalled``: readings have come, but this process stood still.
    """
    m.now += elapsed
    m.clock += elapsed
    m.pulse = clock.NOTHING  # what is reported of the gap is less than it was
    expire(m)
    m.course = None
    m.trust = m.trust._replace(sound=0)
    if m.trust.blocked == "" and m.law is not None:
        name = "stalled" if stalled else "lvdt_silent"
        leapt = has_leapt(m)
        switch_off(p, m, name, leapt)
        report(m, name, f"{lvdt.TEXTS[name]} for more than {p.lvdt.hold_samples} samples")
    return 0.0


def reset(p: Params, m: Memory) -> None:
    """Set estimates and filters to their start, without a bump, and drop doubts about the LVDT."""
    end_doubt(m)
    forget_reported(m)
    m.pause = cycle_watch.NEVER
    m.former = None
    if m.law is not None:
        take_over(p, m, None, True)


def sample(p: Params, m: Memory, reading: float, lost: int, elapsed: float, unpaced: bool) -> float:
    """Voltage [V] until the next reading, after this one [V], before which ``lost`` ones did not come.

    A reading that is not finite is bridged as one that cannot be believed. ``elapsed`` [s]: real time since
    the one before, 0 if it is not known; ``unpaced``: readings come at a wrong period.
    """
    stood = overdue(p, m, reading, lost, elapsed)
    lost += stood
    expected = m.now + p.lvdt.period
    m.now += (1 + min(lost, p.lvdt.hold_samples)) * p.lvdt.period
    m.clock += elapsed if elapsed > 0.0 else (1 + lost) * p.lvdt.period
    if is_behind(p, m, elapsed):
        m.pulse = m.pulse._replace(offset=m.pulse.offset + CATCH_UP * p.lvdt.period)
    m.pulse = clock.NOTHING if unpaced else clock.step(m.pulse, m.clock, m.clock - m.now)
    if lost > 0 and m.course is not None and m.course.stamp == expected == m.course.sent:
        m.course = command_course.postponed(m.course, m.now)  # what came without a time meanwhile is of now
    expire(m)
    if m.now > m.jumped_until:
        m.jumped_until = NEVER
    blocked = m.trust.blocked != ""
    fault, m.judged = lvdt.step(p.lvdt.judge, m.judged, reading, lost, m.voltage, blocked, elapsed)
    if fault != lvdt.SOUND:
        refuse(p, m, fault, lost)
        return voltage_in_force(p, m)
    gap = lost + m.trust.bridged
    if gap > 0:
        bridge(p, m, gap, reading)
    if unpaced and m.trust.blocked == "":
        switch_off(p, m, "lvdt_period", False)
        report(m, "lvdt_period", rate.text(p.lvdt.pace, m.pace))
    applied = m.voltage
    if m.trust.blocked != "":
        back = recover(p, m, reading, gap > 0 or unpaced or m.now < m.pause.until)
        if not back:
            weigh(p, m, reading, applied, 1 + gap)
            return voltage_in_force(p, m)
    elif not answers(p, m, reading, 1 + gap):
        return voltage_in_force(p, m)
    if m.law is None:
        begin(p, m, reading)
    if not advance(p, m, 0, reading):
        leave_the_finite(p, m)
    voltage = m.voltage
    m.measurement = reading
    m.velocity = velocity.step(p.lvdt.tachometer, m.velocity, reading)
    weigh(p, m, reading, applied, 1 + gap)
    if m.evidence is not None and m.evidence.held == 0.0:  # this reading was the last of a block
        watch_block(p, m, applied, m.evidence.shown)
        confront(p, m)
    if m.law is not None and p.cycles.cycling.amplitude > 0.0:
        watch_cycles(p, m, reading, voltage)
    return voltage_in_force(p, m)


def overdue(p: Params, m: Memory, reading: float, lost: int, elapsed: float) -> int:
    """Readings that did not come before this one [V], although no number is missing: the driver stood still.

    The spool has then moved for all of the ``elapsed`` [s]. Before a reading that only comes late, and others
    at its heels, it has moved for one period. The way that is nearer to its own tells which of both.
    """
    periods = elapsed / p.lvdt.period
    most = p.lvdt.hold_samples + 1.5
    if lost > 0 or not OVERDUE <= periods < most or p.lvdt.pace.limit >= rate.ANY or m.law is None:
        return 0
    missing, way, gone = int(periods - 0.5), m.velocity.velocity * p.lvdt.period, reading - m.measurement
    least = max(abs(gone - (1 + missing) * way), 0.5 * abs(way) + NOISE * p.lvdt.judge.tolerance)
    return missing if abs(gone - way) > least else 0


def is_behind(p: Params, m: Memory, elapsed: float) -> bool:
    """Whether the clock of the samples lacks a time in which the driver stood still, and the spool rested.

    Readings that came late in a burst make good what they lack; this one came in time, ``elapsed`` [s] after
    the one before.
    """
    if m.pulse.messages == 0.0 or elapsed < rate.QUICK * p.lvdt.period:
        return False
    behind = m.clock - m.now - m.pulse.offset
    return elapsed < OVERDUE * p.lvdt.period < behind


def voltage_in_force(p: Params, m: Memory) -> float:
    """Voltage [V] of the amplifier that is in force: 0 V while the law does not have the valve."""
    if m.law is None:
        return 0.0
    return amplified(p, m.voltage)


# Readings that cannot be believed, or do not come


def refuse(p: Params, m: Memory, fault: str, lost: int) -> None:
    """Bridge a reading that cannot be believed, or switch off if there have been too many."""
    count(m, "lvdt_refused")
    m.trust = m.trust._replace(bridged=m.trust.bridged + 1 + lost, sound=0)
    if m.trust.blocked != "":
        return
    if fault == "lvdt_frozen" or m.trust.bridged > p.lvdt.hold_samples:
        switch_off(p, m, fault, False)
        report(m, fault, f"{lvdt.TEXTS[fault]}{lvdt.lateness(m.judged)}")
        return
    if fault == "lvdt_jump":
        m.jumped_until = m.now + LATCH
    latch(m, f"{fault}_bridged", f"{lvdt.TEXTS[fault]}: bridged")


def bridge(p: Params, m: Memory, gap: int, reading: float) -> None:
    """Step the law over ``gap`` samples before a sound ``reading`` [V], or switch off."""
    leapt = has_leapt(m)
    m.trust = m.trust._replace(bridged=0)
    if m.trust.blocked != "" or m.law is None:
        return
    if gap > p.lvdt.hold_samples:
        switch_off(p, m, "lvdt_silent", leapt)
        report(m, "lvdt_silent", f"{gap} LVDT readings lost in a row")
        return
    latch(m, "lvdt_bridged", "LVDT readings lost: bridged")
    newest = m.command.value
    finite = advance(p, m, gap, reading)
    m.command = m.command._replace(value=newest)
    if not finite:
        leave_the_finite(p, m)


def answers(p: Params, m: Memory, reading: float, samples: int) -> bool:
    """Whether the spool answers the voltage of the ``samples`` before ``reading`` [V]; else switch off."""
    doubted = m.trust.doubt.times > 0.0
    wrong, m.response = answer.step(
        p.lvdt.judge, m.response, reading, m.judged.rate, m.voltage, samples, doubted
    )
    if wrong == "" or p.lvdt.comparison is None or not p.answered:
        if abs(m.response.pull) < answer.AGREED * p.lvdt.judge.disturbance and not doubted:
            m.proven = m.law
        return True
    report(m, "lvdt_disagrees", f"{lvdt.TEXTS['disagrees']}: {plausibility.TEXTS[wrong]}")
    switch_off(p, m, "lvdt_disagrees", False)
    return False


def has_leapt(m: Memory) -> bool:
    """Whether readings that are being bridged leapt: after a gap they would be taken for motion."""
    return m.trust.bridged > 0 and m.jumped_until >= 0.0


@node_only
def watch_block(p: Params, m: Memory, applied: float, shown: plausibility.Shown) -> None:
    """Let the watches of the table look at a block, at whose end ``applied`` [V] is on; it has ``shown``."""
    command = m.effective if math.isfinite(m.effective) else 0.0
    last, doubted = m.judged.standing, m.trust.doubt.times > 0.0
    motion = shown.y3, shown.velocity, shown.u4, shown.warm == 0.0
    block = plausibility.Block(*motion, doubted, command, applied, last.second, last.grain)
    reported_of(p.watches, m, block)


@node_only
def unwatched(p: Params, m: Memory, applied: float, shown: plausibility.Shown) -> None:
    """Watches that only report, where nobody hears them: in C and its twin."""


def weigh(p: Params, m: Memory, reading: float, applied: float, samples: int) -> None:
    """Compare one more ``reading`` [V] with ``applied`` [V], which was on for ``samples`` periods before."""
    if p.lvdt.comparison is None:
        return
    if m.evidence is None:
        m.evidence = plausibility.initial(p.lvdt.comparison, reading, applied)
    m.evidence = plausibility.step(p.lvdt.comparison, m.evidence, reading, applied, float(samples))


def confront(p: Params, m: Memory) -> None:
    """Switch off if readings and voltage have shown together that the readings are wrong."""
    if p.lvdt.comparison is None or m.evidence is None or m.trust.blocked != "" or not p.answered:
        return
    found, doubt = plausibility.verdict(p.lvdt.comparison, m.evidence, m.trust.doubt)
    if found == "gain" and cycle_watch.unexplained(m.cycle, m.swing):
        return  # even cycles have a gain of their own if readings are late
    if found != "":
        report(
            m,
            "lvdt_disagrees",
            f"{lvdt.TEXTS['disagrees']}: "
            f"{plausibility.words(found, p.lvdt.comparison, m.evidence, m.trust.doubt)}",
        )
        switch_off(p, m, "lvdt_disagrees", False)
    elif doubt.times != m.trust.doubt.times:
        end_doubt(m)


def end_doubt(m: Memory) -> None:
    """Trust the LVDT again."""
    m.trust = m.trust._replace(doubt=plausibility.TRUST)
    clear(m, "lvdt_doubted")


# Cycles of the voltage


def watch_cycles(p: Params, m: Memory, reading: float, voltage: float) -> None:
    """Look for even cycles in the ``voltage`` [V] after ``reading`` [V], and measure them while they last."""
    cycles, swings, rising = m.cycle.cycles, m.swing.cycles, m.cycle.command_rising
    m.cycle = oscillation.step(p.cycles.cycling, m.cycle, m.now, voltage, m.effective)
    full = p.cycles.full if m.trust.doubt.times == 0.0 else p.cycles.doubted
    if abs(voltage) >= full.amplitude or m.cycle.command_rising != rising:
        m.swing = oscillation.step(full, m.swing, m.now, voltage, m.effective)
    if m.probe.frequency > 0.0:
        m.probe = lock_in.step(m.probe, voltage, reading, p.lvdt.period)
    if m.cycle.cycles != cycles:
        judge_cycles(p, m, m.cycle, full.amplitude)
    if m.swing.cycles != swings and m.law is not None:
        judge_cycles(p, m, m.swing, full.amplitude)


def judge_cycles(p: Params, m: Memory, cycle: oscillation.State, high: float) -> None:
    """Report ``cycle`` after one more in a row, and its source; ``high`` [V]: amplitude of saturated ones.

    Switch off if they stay saturated.
    """
    if max(m.cycle.cycles, m.swing.cycles) < cycle_watch.BEGUN:
        m.probe = lock_in.NOTHING
        m.source = ""
    if cycle.cycles < cycle_watch.BEGUN or oscillation.explained(cycle):
        return
    if m.probe.frequency == 0.0:
        m.probe = lock_in.begun(1.0 / cycle.length, p.lvdt.period)
        return
    if not oscillation.sustained(cycle) or not lock_in.finished(m.probe):
        return
    found = lock_in.found(p.lvdt.judge, m.probe)
    m.source = cycle_watch.source(cycle, found, high, m.judged.standing.grain)
    latch(m, m.source, cycle_watch.text(m.source, cycle, found), max(LATCH, 2.0 * cycle.length))
    if p.answered and oscillation.amplitude(cycle) >= high and cycle_watch.lasts(cycle):
        report(m, "limit_cycle", cycle_watch.stop_text(m.source, cycle, found))
        m.pause = cycle_watch.paused(p.lvdt, m.pause, m.now)
        switch_off(p, m, "limit_cycle", False)


# Off and on again


def leave_the_finite(p: Params, m: Memory) -> None:
    """Switch off for a while: the law has produced NaN or infinity, or raised an error."""
    count(m, "law_not_finite")
    m.pause = cycle_watch.paused(p.lvdt, m.pause, m.now)
    switch_off(p, m, "law_not_finite", False)
    report(m, "law_not_finite", f"the control law {m.name} produced NaN or infinity after {m.now:.3f} s")
    m.former = None


def switch_off(p: Params, m: Memory, name: str, leapt: bool) -> None:
    """Give 0 V because of ``name``; ``leapt``: readings had leapt."""
    doubt = m.trust.doubt
    if (leapt or name in lvdt_trust.DOUBTS) and p.lvdt.comparison is not None and p.answered:
        doubt = plausibility.doubted(doubt, m.evidence, m.now, p.lvdt.hold_off, p.lvdt.hold_off_limit)
        clear(m, "lvdt_doubted")
    m.trust = m.trust._replace(sound=0, blocked=name, doubt=doubt)
    count(m, "safe_stops")
    m.voltage = p.neutral
    m.former = m.law if doubt.times == 0.0 else m.proven
    m.law = None
    m.response = answer.NOTHING
    m.transfer = bumpless_transfer.NOTHING
    m.fading = False
    m.lead = None
    m.course = None
    m.cycle = oscillation.NOTHING  # switching on and off is no limit cycle of law and valve
    m.swing = oscillation.NOTHING
    m.probe = lock_in.NOTHING
    m.source = ""
    forget_saturation(m)
    stop_reporting(m)


def recover(p: Params, m: Memory, reading: float, anew: bool) -> bool:
    """Whether the law has the valve again: enough sound readings have come, and the spool is at rest.

    ``anew``: the count begins with this one. At the end the motion is that of the reading before: the law
    takes in the present one in its first step.
    """
    sound = 0 if anew else m.trust.sound
    if sound == 0:
        m.measurement = reading
        m.velocity = velocity.State(reading, 0.0)
        if p.lvdt.comparison is not None:
            usual = 0.0 if m.evidence is None else m.evidence.shown.usual
            m.evidence = plausibility.initial(p.lvdt.comparison, reading, 0.0, usual)
    speed = abs(m.velocity.velocity)
    resting = speed <= lvdt_trust.REST or sound * p.lvdt.period >= lvdt_trust.REST_LIMIT
    m.trust = m.trust._replace(sound=sound + 1)
    if m.trust.sound < p.lvdt.recovery_samples or not resting or m.now < m.trust.doubt.until:
        m.measurement = reading
        m.velocity = velocity.step(p.lvdt.tachometer, m.velocity, reading)
        return False
    if m.evidence is not None:
        m.evidence = plausibility.anew(m.evidence)
    clear(m, m.trust.blocked)
    m.trust = m.trust._replace(blocked="")
    if m.trust.doubt.times > 0.0:
        report(m, "lvdt_doubted", lvdt.TEXTS["doubted"])
    welcome(p, m, reading)
    take_over(p, m, m.former, False)
    return True


def welcome(p: Params, m: Memory, reading: float) -> None:
    """Let the law hold the valve at ``reading`` [V] until a command comes."""
    clear(m, "lvdt_missing")
    m.command = command_watch.welcomed(p.command, m.command, reading, m.now)
    if m.command.homing is not None:
        report(m, "command_silent", command_watch.SILENT)
    if m.command.value is None:
        report(m, "command_missing", "no command yet")


def begin(p: Params, m: Memory, reading: float) -> None:
    """Start the law: as offline if all is at rest, without a bump if spool or command are elsewhere."""
    m.measurement = reading
    m.velocity = velocity.State(reading, 0.0)
    m.voltage = p.neutral
    welcome(p, m, reading)
    wanted = 0.0 if m.command.value is None else m.command.value
    if p.lockstep or max(abs(reading), abs(wanted)) <= p.lvdt.judge.tolerance:
        m.law = law_initial(p.law, Start(reading, m.voltage, reading, 0.0, 0.0))
    else:
        take_over(p, m, None, False)


def take_over(p: Params, m: Memory, former: Any | None, following: bool) -> None:
    """Start the law where the spool is, with the estimates of its ``former`` state.

    ``following``: the spool has been following the command until now.
    """
    follow(p, m, m.now)
    y, v = m.measurement, m.velocity.velocity
    start = Start(y, m.voltage, y, v, v)
    base = target(p, m)  # which may end a way home and begin an offset
    base -= m.transfer.command.value
    held, left = law_steady_command(p.law, start), 0.0
    # A spool that follows has the rate of the command; one from elsewhere has to lose its own.
    offset = bumpless_transfer.Offset(held - base, 0.0)
    if not following:
        offset, left = bumpless_transfer.Offset(0.0, v), bumpless_transfer.JOINING * p.transfer.time
    law = p.law if former is None else law_resumed(p.law, former)
    m.law = law_initial(law, start)
    m.transfer = bumpless_transfer.State(m.transfer.voltage, offset, True, held, left)
    m.fading = True


def go_on(p: Params, m: Memory, former: Any, reference: Any) -> None:
    """Start the law where the spool is, with the estimates of the ``former`` state of another.

    ``reference``: the one that this law followed, with its rate.
    """
    follow(p, m, m.now)
    y, v = m.measurement, m.velocity.velocity
    start = Start(y, m.voltage, reference.reference, reference.rate, v)
    target(p, m)
    m.law = law_initial(law_resumed(p.law, former), start)
    m.transfer = m.transfer._replace(taking_over=True)
    m.fading = True


# The law


def advance(p: Params, m: Memory, gap: int, reading: float) -> bool:
    """Run ``hold`` over a ``gap`` before ``reading`` [V], or ``control`` if there is none, and catch errors.

    False if it produced NaN or infinity, or raised an error: C goes on with what it computes instead.
    """
    try:
        if gap > 0:
            hold(p, m, gap, reading)
            return True
        return control(p, m, reading)
    except Exception as error:  # a law of another package may raise any
        report(m, "law_not_finite", f"the control law {m.name} raised {in_words(error)} after {m.now:.3f} s")
        return False


def hold(p: Params, m: Memory, gap: int, reading: float) -> None:
    """Step the law over ``gap`` samples without a reading, on a straight line to ``reading`` [V]."""
    slope = (reading - m.measurement) / (gap + 1)
    newest, used = m.command.value, m.used
    for i in range(1, gap + 1):
        between = m.measurement + i * slope
        now = m.now - (gap + 1 - i) * p.lvdt.period
        if m.trajectory is not None or (m.course is not None and m.course.stamp != m.course.sent):
            follow(p, m, now)
        elif newest is not None and used is not None and m.command.homing is None:
            m.command = m.command._replace(value=used + i * (newest - used) / (gap + 1))
        m.velocity = velocity.step(p.lvdt.tachometer, m.velocity, between)
        wanted = taken_in(p, m)
        m.law = law_hold(p.law, m.law, wanted, between, m.voltage)
        if m.fading:
            fade(p, m)


def control(p: Params, m: Memory, reading: float) -> bool:
    """Compute one step of the law and hand out its voltage; False, and none, if it is not finite."""
    law = p.law
    if m.trust.doubt.times != 0.0 and p.lvdt.comparison is not None:
        law = law._replace(u_max=min(law.u_max, p.probation))
    follow(p, m, m.now)
    wanted = taken_in(p, m)
    m.effective = wanted
    m.used = m.command.value
    if m.transfer.taking_over:
        _, _, first = law_step(law, m.law, wanted, reading, 0.0)
        offset = bumpless_transfer.Offset(m.voltage - first.unsaturated_voltage, 0.0)
        m.transfer = m.transfer._replace(voltage=offset, taking_over=False)
        m.fading = True
    voltage, after, terms = law_step(law, m.law, wanted, reading, m.transfer.voltage.value)
    if not are_finite(voltage, terms):
        return False
    m.voltage = voltage
    hand_out(amplified(p, voltage))
    m.law = after
    observe(m, terms, voltage)
    if m.fading:
        fade(p, m)
    return True


def fade(p: Params, m: Memory) -> None:
    """Let both offsets of a takeover decay by one period."""
    m.transfer = bumpless_transfer.step(p.transfer, m.transfer)
    voltage, command = m.transfer.voltage, m.transfer.command
    m.fading = m.transfer.left > 0.0 or (
        voltage.value != 0.0 or voltage.rate != 0.0 or command.value != 0.0 or command.rate != 0.0
    )


def follow(p: Params, m: Memory, now: float) -> None:
    """The command in force is that of trajectory or course at ``now`` [s], if there is one."""
    if m.trajectory is not None:
        m.motion = points.motion(p.course, m.trajectory, now)
        m.command = command_watch.moved(m.command, m.motion.position)
    elif m.course is not None and m.command.homing is None:
        m.command = command_watch.moved(m.command, command_course.value(p.course, m.course, now))


def taken_in(p: Params, m: Memory) -> float:
    """Command [V] of this sample as the law gets it, after its lead has followed it."""
    value = m.command.value
    if m.trajectory is not None:
        m.lead = None
    elif p.lead is not None and value is not None:
        before = command_lead.initial(value) if m.lead is None else m.lead
        m.lead = command_lead.step(p.lead, before, value)
    wanted = target(p, m)
    return bumpless_transfer.joined(p.transfer, m.transfer, wanted)


def target(p: Params, m: Memory) -> float:
    """Command [V] of this sample, with its lead or its derivatives, and with its offset."""
    homing = m.command.homing is not None
    wanted, m.command, offset = command_watch.step(p.command, m.command, m.transfer.command, m.now)
    if homing != (m.command.homing is not None):
        if homing:
            m.transfer = m.transfer._replace(command=offset)
            m.fading = True
            clear(m, "command_silent")
        else:
            report(m, "command_silent", command_watch.SILENT)
    value = m.command.value
    if value is None or m.command.homing is not None:
        return wanted
    if m.trajectory is not None and p.reshapes:
        return law_commanded(p.law, m.motion) + m.transfer.command.value
    if p.lead is None or m.lead is None:
        return wanted
    return command_lead.led(p.lead, m.lead, value) + m.transfer.command.value
