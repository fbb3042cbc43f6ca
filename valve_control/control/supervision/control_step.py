# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Steps one valve from reading to voltage: the supervisor's machine, for nodes, replay and exported C.

All functions work on one ``Memory``, which they change, and on ``Params``, which they do not: of each part
``memory`` has the state and ``p`` the parameters. binding.py puts the functions of a law, and of who runs the
machine, in the places that are kept for them. The translator of export/ makes C of the same functions; it
leaves out the calls of those that are marked as ``node_only``.
"""

import math
from typing import Any, NamedTuple

from valve_control.control.compiling import in_words
from valve_control.control.laws import command_lead, linearisation, reshaping
from valve_control.control.laws import velocity as tachometer
from valve_control.control.laws.places import law_hold, law_initial, law_step  # filled by binding.py
from valve_control.control.laws.projection import Theta, clip
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate
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
    watch_table,
)
from valve_control.control.supervision import clock as clocks
from valve_control.control.supervision import trajectory as points
from valve_control.control.supervision.memory import (
    LATCH,
    NEVER,
    Memory,
    clear,
    count,
    expire,
    forget_saturation,
    forget_watches,
    latch,
    node_only,
    report,
    step_watches,
    stop_watches,
)
from valve_control.parameter import Values, number, word

BOTH = "spool_command is ignored while spool_trajectory commands"
OVERDUE = 2.5  # periods since the last reading, from which the driver may have stood still
CATCH_UP = 0.25  # of a period for each reading, by which such a time is made up for without a kink
NOT_FINITE = "the control law {} produced NaN or infinity after {:.3f} s"
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
    trust = lvdt_trust.design(values, law)
    probation = lvdt_trust.PROBATION * number(values, "lvdt.disturbance") or math.inf
    return Params(
        law,
        command_watch.design(values),
        trust,
        cycle_watch.Params(
            oscillation.Params(least_cycle, trust.period),
            cycle_watch.between(law.u_max, trust.period),
            cycle_watch.between(min(law.u_max, probation), trust.period),
        ),
        watch_table.design(values, trust.comparison),
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
def give_voltage(voltage: float) -> None:
    """Place of what is done with the voltage [V] as soon as it is certain."""


@node_only
def observe(memory: Memory, terms: Any, voltage: float) -> None:
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


def command(p: Params, memory: Memory, value: float, stamp: float, since: float) -> None:
    """Take in a command ``value`` [V], sent at ``stamp`` [s] of its sender's clock.

    It came ``since`` [s] after the last reading. Without one of both (NaN) it is that of the next sample. It
    is limited; one that is not finite is refused, and any while a trajectory commands.
    """
    if not math.isfinite(value):
        memory.command = command_watch.taken(p.command, memory.command, value, memory.now)
        count(memory, "command_refused")
        latch(memory, "command_refused", f"command {value} refused, the last one holds")
        return
    if follows_trajectory(p, memory):
        latch(memory, "command_both", BOTH)
        return
    memory.trajectory = None
    sent = sent_at(p, memory, stamp, since)
    before = memory.course if memory.command.homing is None else None
    limited = saturate(value, p.course.limit)
    memory.course = command_course.taken(
        p.course, before, limited, sent, stamp if math.isfinite(stamp) else sent
    )
    renew(p, memory, value)


def sent_at(p: Params, memory: Memory, stamp: float, since: float) -> float:
    """When [s] on the clock of the samples a message was sent; ``stamp`` and ``since`` as of ``command``.

    Readings tell how the clock of this process and that of the samples differ, messages that of the sender.
    """
    if not (math.isfinite(stamp) and math.isfinite(since)):
        return memory.now + p.course.period
    came = memory.clock + since
    memory.sender = clocks.step(memory.sender, came, came - stamp)
    return stamp + clocks.offset(memory.sender) - clocks.offset(memory.pulse)


def trajectory(p: Params, memory: Memory, point: points.Motion, stamp: float, since: float) -> bool:
    """Take in a ``point`` of a trajectory; whether it can be used. Times as of ``command``."""
    follows = follows_trajectory(p, memory)
    before = memory.trajectory if follows else None
    arrival = memory.now + p.course.period
    backwards = points.backwards(p.course, before, stamp, arrival)
    if not points.usable(point, backwards):
        count(memory, "command_refused")
        latch(memory, "command_refused", points.fault(point, backwards))
        return False
    sent = sent_at(p, memory, stamp, since)
    time = stamp if math.isfinite(stamp) else sent
    memory.trajectory = points.taken(p.course, before, point, sent, time, arrival)
    memory.course = None
    renew(p, memory, point.position)
    return True


def trajectory_gone(memory: Memory) -> None:
    """Take commands again: the sender of the trajectory has left."""
    memory.trajectory = None


def command_gone(memory: Memory) -> None:
    """Count the command as silent at once: the upper level has left."""
    if memory.command.gone_since is None:
        memory.command = memory.command._replace(gone_since=memory.now)


def follows_trajectory(p: Params, memory: Memory) -> bool:
    """Whether there is a trajectory that is not silent."""
    if memory.trajectory is None or memory.command.gone_since is not None:
        return False
    patience = PATIENCE if p.command.timeout == 0.0 else p.command.timeout
    return memory.now <= memory.trajectory.arrival + patience


def renew(p: Params, memory: Memory, value: float) -> None:
    """The upper level has spoken: its command ``value`` [V] counts from the next sample on."""
    memory.command = command_watch.taken(p.command, memory.command, value, memory.now)
    clear(memory, "command_missing")
    if memory.command.value != value:
        count(memory, "command_limited")
        latch(memory, "command_limited", f"command {value:g} V limited to {memory.command.value:g} V")


def silence(p: Params, memory: Memory, elapsed: float, stalled: bool) -> float:
    """Switch off after ``elapsed`` [s] without a reading, too long to be bridged; returns the voltage [V].

    ``stalled``: readings have come, but this process stood still.
    """
    memory.now += elapsed
    memory.clock += elapsed
    memory.pulse = clocks.NOTHING  # what is reported of the gap is less than it was
    expire(memory)
    memory.course = None
    memory.trust = memory.trust._replace(sound=0)
    if memory.trust.blocked == "" and memory.law is not None:
        name = "stalled" if stalled else "lvdt_silent"
        leapt = has_leapt(memory)
        switch_off(p, memory, name, leapt)
        report(memory, name, f"{lvdt.TEXTS[name]} for more than {p.lvdt.hold_samples} samples")
    return 0.0


def reset(p: Params, memory: Memory) -> None:
    """Set estimates and filters to their start, without a bump, and drop doubts about the LVDT."""
    end_doubt(memory)
    forget_watches(memory)
    memory.pause = cycle_watch.NEVER
    memory.former = None
    if memory.law is not None:
        take_over(p, memory, None, True)


def sample(p: Params, memory: Memory, reading: float, lost: int, elapsed: float, unpaced: bool) -> float:
    """Voltage [V] until the next reading, after this one [V], before which ``lost`` ones did not come.

    A reading that is not finite is bridged as one that cannot be believed. ``elapsed`` [s]: real time since
    the one before, 0 if it is not known; ``unpaced``: readings come at a wrong period. What is watched after
    the law's step may switch off: then 0 V is for the next reading, since the voltage of this one is out.
    """
    stood = overdue(p, memory, reading, lost, elapsed)
    lost += stood
    expected = memory.now + p.lvdt.period
    memory.now += (1 + min(lost, p.lvdt.hold_samples)) * p.lvdt.period
    memory.clock += elapsed if elapsed > 0.0 else (1 + lost) * p.lvdt.period
    if is_behind(p, memory, elapsed):
        memory.pulse = memory.pulse._replace(offset=memory.pulse.offset + CATCH_UP * p.lvdt.period)
    memory.pulse = (
        clocks.NOTHING if unpaced else clocks.step(memory.pulse, memory.clock, memory.clock - memory.now)
    )
    if lost > 0 and memory.course is not None and memory.course.stamp == expected == memory.course.sent:
        memory.course = command_course.postponed(memory.course, memory.now)  # without a stamp it is of now
    expire(memory)
    if memory.now > memory.jumped_until:
        memory.jumped_until = NEVER
    blocked = memory.trust.blocked != ""
    fault, memory.judged = lvdt.step(
        p.lvdt.judge, memory.judged, reading, lost, memory.voltage, blocked, elapsed
    )
    if fault != lvdt.SOUND:
        refuse(p, memory, fault, lost)
        return voltage_in_force(p, memory)
    gap = lost + memory.trust.bridged
    if gap > 0:
        bridge(p, memory, gap, reading)
    if unpaced and memory.trust.blocked == "":
        switch_off(p, memory, "lvdt_period", False)
        report(memory, "lvdt_period", rate.text(p.lvdt.pace, memory.pace))
    applied = memory.voltage
    if memory.trust.blocked != "":
        back = recover(p, memory, reading, gap > 0 or unpaced or memory.now < memory.pause.until)
        if not back:
            compare_reading(p, memory, reading, applied, 1 + gap)
            return voltage_in_force(p, memory)
    elif not answers(p, memory, reading, 1 + gap):
        return voltage_in_force(p, memory)
    if memory.law is None:
        begin(p, memory, reading)
    if not advance(p, memory, 0, reading):
        stop_failed_law(p, memory)
    voltage = memory.voltage
    given = voltage_in_force(p, memory)
    memory.measurement = reading
    memory.velocity = tachometer.step(p.lvdt.tachometer, memory.velocity, reading)
    compare_reading(p, memory, reading, applied, 1 + gap)
    if memory.evidence is not None and memory.evidence.held == 0.0:  # this reading was the last of a block
        watch_block(p, memory, applied, memory.evidence.shown)
        check_plausibility(p, memory)
    if memory.law is not None and p.cycles.cycling.amplitude > 0.0:
        watch_cycles(p, memory, reading, voltage)
    return given


def overdue(p: Params, memory: Memory, reading: float, lost: int, elapsed: float) -> int:
    """Readings that did not come before this one [V], although no number is missing: the driver stood still.

    The spool has then moved for all of the ``elapsed`` [s]. Before a reading that only comes late, and others
    at its heels, it has moved for one period. The way that is nearer to its own tells which of both.
    """
    periods = elapsed / p.lvdt.period
    most = p.lvdt.hold_samples + 1.5
    if lost > 0 or not OVERDUE <= periods < most or p.lvdt.pace.limit >= rate.ANY or memory.law is None:
        return 0
    missing, way = int(periods - 0.5), memory.velocity.velocity * p.lvdt.period
    gone = reading - memory.measurement
    least = max(abs(gone - (1 + missing) * way), 0.5 * abs(way) + NOISE * p.lvdt.judge.tolerance)
    return missing if abs(gone - way) > least else 0


def is_behind(p: Params, memory: Memory, elapsed: float) -> bool:
    """Whether the clock of the samples lacks a time in which the driver stood still, and the spool rested.

    Readings that came late in a burst make good what they lack; this one came in time, ``elapsed`` [s] after
    the one before.
    """
    if memory.pulse.messages == 0.0 or elapsed < rate.QUICK * p.lvdt.period:
        return False
    behind = memory.clock - memory.now - memory.pulse.offset
    return elapsed < OVERDUE * p.lvdt.period < behind


def voltage_in_force(p: Params, memory: Memory) -> float:
    """Voltage [V] of the amplifier that is in force: 0 V while the law does not have the valve."""
    if memory.law is None:
        return 0.0
    return amplified(p, memory.voltage)


# Readings that cannot be believed, or do not come


def refuse(p: Params, memory: Memory, fault: str, lost: int) -> None:
    """Keep the voltage for a reading that cannot be believed, or switch off if there have been too many."""
    count(memory, "lvdt_refused")
    memory.trust = memory.trust._replace(bridged=memory.trust.bridged + 1 + lost, sound=0)
    if memory.trust.blocked != "":
        return
    if fault == "lvdt_frozen" or memory.trust.bridged > p.lvdt.hold_samples:
        switch_off(p, memory, fault, False)
        report(memory, fault, f"{lvdt.TEXTS[fault]}{lvdt.lateness(memory.judged)}")
        return
    if fault == "lvdt_jump":
        memory.jumped_until = memory.now + LATCH
    latch(memory, f"{fault}_bridged", f"{lvdt.TEXTS[fault]}: bridged")


def bridge(p: Params, memory: Memory, gap: int, reading: float) -> None:
    """Step the law over ``gap`` samples before a sound ``reading`` [V], or switch off."""
    leapt = has_leapt(memory)
    memory.trust = memory.trust._replace(bridged=0)
    if memory.trust.blocked != "" or memory.law is None:
        return
    if gap > p.lvdt.hold_samples:
        switch_off(p, memory, "lvdt_silent", leapt)
        report(memory, "lvdt_silent", f"{gap} LVDT readings lost in a row")
        return
    latch(memory, "lvdt_bridged", "LVDT readings lost: bridged")
    newest = memory.command.value
    finite = advance(p, memory, gap, reading)
    memory.command = memory.command._replace(value=newest)
    if not finite:
        stop_failed_law(p, memory)


def answers(p: Params, memory: Memory, reading: float, samples: int) -> bool:
    """Whether the spool answers the voltage of the ``samples`` before ``reading`` [V]; else switch off."""
    doubted = memory.trust.doubt.times > 0.0
    wrong, memory.response = answer.step(
        p.lvdt.judge, memory.response, reading, memory.judged.rate, memory.voltage, samples, doubted
    )
    if wrong == "" or p.lvdt.comparison is None or not p.answered:
        if abs(memory.response.pull) < answer.AGREED * p.lvdt.judge.disturbance and not doubted:
            memory.proven = memory.law
        return True
    report(memory, "lvdt_disagrees", f"{lvdt.TEXTS['disagrees']}: {plausibility.TEXTS[wrong]}")
    switch_off(p, memory, "lvdt_disagrees", False)
    return False


def has_leapt(memory: Memory) -> bool:
    """Whether readings that are being bridged leapt: after a gap they would be taken for motion."""
    return memory.trust.bridged > 0 and memory.jumped_until >= 0.0


@node_only
def watch_block(p: Params, memory: Memory, applied: float, shown: plausibility.Shown) -> None:
    """Let the watches of the table look at a block, at whose end ``applied`` [V] is on; it has ``shown``."""
    command = memory.effective if math.isfinite(memory.effective) else 0.0
    last, doubted = memory.judged.standing, memory.trust.doubt.times > 0.0
    motion = shown.y3, shown.velocity, shown.u4, shown.warm == 0.0
    block = plausibility.Block(*motion, doubted, command, applied, last.second, last.grain)
    step_watches(p.watches, memory, block)


@node_only
def no_watches(p: Params, memory: Memory, applied: float, shown: plausibility.Shown) -> None:
    """Watches that only report, where nobody hears them: in C and its twin."""


def compare_reading(p: Params, memory: Memory, reading: float, applied: float, samples: int) -> None:
    """Compare one more ``reading`` [V] with ``applied`` [V], which was on for ``samples`` periods before."""
    if p.lvdt.comparison is None:
        return
    if memory.evidence is None:
        memory.evidence = plausibility.initial(p.lvdt.comparison, reading, applied)
    memory.evidence = plausibility.step(p.lvdt.comparison, memory.evidence, reading, applied, float(samples))


def check_plausibility(p: Params, memory: Memory) -> None:
    """Switch off if readings and voltage have shown together that the readings are wrong."""
    if p.lvdt.comparison is None or memory.evidence is None or memory.trust.blocked != "" or not p.answered:
        return
    found, doubt = plausibility.verdict(p.lvdt.comparison, memory.evidence, memory.trust.doubt)
    if found == "gain" and cycle_watch.unexplained(memory.cycle, memory.swing):
        return  # even cycles have a gain of their own if readings are late
    if found != "":
        report(
            memory,
            "lvdt_disagrees",
            f"{lvdt.TEXTS['disagrees']}: "
            f"{plausibility.words(found, p.lvdt.comparison, memory.evidence, memory.trust.doubt)}",
        )
        switch_off(p, memory, "lvdt_disagrees", False)
    elif doubt.times != memory.trust.doubt.times:
        end_doubt(memory)


def end_doubt(memory: Memory) -> None:
    """Trust the LVDT again."""
    memory.trust = memory.trust._replace(doubt=plausibility.TRUST)
    clear(memory, "lvdt_doubted")


# Cycles of the voltage


def watch_cycles(p: Params, memory: Memory, reading: float, voltage: float) -> None:
    """Look for even cycles in the ``voltage`` [V] after ``reading`` [V], and measure them while they last."""
    cycles, swings, rising = memory.cycle.cycles, memory.swing.cycles, memory.cycle.command_rising
    memory.cycle = oscillation.step(p.cycles.cycling, memory.cycle, memory.now, voltage, memory.effective)
    full = p.cycles.full if memory.trust.doubt.times == 0.0 else p.cycles.doubted
    if abs(voltage) >= full.amplitude or memory.cycle.command_rising != rising:
        memory.swing = oscillation.step(full, memory.swing, memory.now, voltage, memory.effective)
    if memory.probe.frequency > 0.0:
        memory.probe = lock_in.step(memory.probe, voltage, reading, p.lvdt.period)
    if memory.cycle.cycles != cycles:
        judge_cycles(p, memory, memory.cycle, full.amplitude)
    if memory.swing.cycles != swings and memory.law is not None:
        judge_cycles(p, memory, memory.swing, full.amplitude)


def judge_cycles(p: Params, memory: Memory, cycle: oscillation.State, high: float) -> None:
    """Report ``cycle`` after one more in a row, and its source; ``high`` [V]: amplitude of saturated ones.

    Switch off if they stay saturated.
    """
    if max(memory.cycle.cycles, memory.swing.cycles) < cycle_watch.BEGUN:
        memory.probe = lock_in.NOTHING
        memory.source = ""
    if cycle.cycles < cycle_watch.BEGUN or oscillation.explained(cycle):
        return
    if memory.probe.frequency == 0.0:
        memory.probe = lock_in.begun(1.0 / cycle.length, p.lvdt.period)
        return
    if not oscillation.sustained(cycle) or not lock_in.finished(memory.probe):
        return
    found = lock_in.found(p.lvdt.judge, memory.probe)
    memory.source = cycle_watch.source(cycle, found, high, memory.judged.standing.grain)
    latch(
        memory, memory.source, cycle_watch.text(memory.source, cycle, found), max(LATCH, 2.0 * cycle.length)
    )
    if p.answered and oscillation.amplitude(cycle) >= high and cycle_watch.lasts(cycle):
        report(memory, "limit_cycle", cycle_watch.stop_text(memory.source, cycle, found))
        memory.pause = cycle_watch.paused(p.lvdt, memory.pause, memory.now)
        switch_off(p, memory, "limit_cycle", False)


# Off and on again


def stop_failed_law(p: Params, memory: Memory) -> None:
    """Switch off for a while: the law has produced NaN or infinity, or raised an error."""
    count(memory, "law_not_finite")
    memory.pause = cycle_watch.paused(p.lvdt, memory.pause, memory.now)
    switch_off(p, memory, "law_not_finite", False)
    report(memory, "law_not_finite", NOT_FINITE.format(memory.name, memory.now))
    memory.former = None


def switch_off(p: Params, memory: Memory, name: str, leapt: bool) -> None:
    """Give 0 V because of ``name``; ``leapt``: readings had leapt."""
    doubt = memory.trust.doubt
    if (leapt or name in lvdt_trust.DOUBTS) and p.lvdt.comparison is not None and p.answered:
        doubt = plausibility.doubted(
            doubt, memory.evidence, memory.now, p.lvdt.hold_off, p.lvdt.hold_off_limit
        )
        clear(memory, "lvdt_doubted")
    memory.trust = memory.trust._replace(sound=0, blocked=name, doubt=doubt)
    count(memory, "safe_stops")
    memory.voltage = p.neutral
    memory.former = memory.law if doubt.times == 0.0 else memory.proven
    memory.law = None
    memory.response = answer.NOTHING
    memory.transfer = bumpless_transfer.NOTHING
    memory.fading = False
    memory.lead = None
    memory.course = None
    memory.cycle = oscillation.NOTHING  # switching on and off is no limit cycle of law and valve
    memory.swing = oscillation.NOTHING
    memory.probe = lock_in.NOTHING
    memory.source = ""
    forget_saturation(memory)
    stop_watches(memory)


def recover(p: Params, memory: Memory, reading: float, anew: bool) -> bool:
    """Whether the law has the valve again: enough sound readings have come, and the spool is at rest.

    ``anew``: the count begins with this one. At the end the motion is that of the reading before: the law
    takes in the present one in its first step.
    """
    sound = 0 if anew else memory.trust.sound
    if sound == 0:
        memory.measurement = reading
        memory.velocity = tachometer.State(reading, 0.0)
        if p.lvdt.comparison is not None:
            usual = 0.0 if memory.evidence is None else memory.evidence.shown.usual
            memory.evidence = plausibility.initial(p.lvdt.comparison, reading, 0.0, usual)
    speed = abs(memory.velocity.velocity)
    resting = speed <= lvdt_trust.REST or sound * p.lvdt.period >= lvdt_trust.REST_LIMIT
    memory.trust = memory.trust._replace(sound=sound + 1)
    if memory.trust.sound < p.lvdt.recovery_samples or not resting or memory.now < memory.trust.doubt.until:
        memory.measurement = reading
        memory.velocity = tachometer.step(p.lvdt.tachometer, memory.velocity, reading)
        return False
    if memory.evidence is not None:
        memory.evidence = plausibility.anew(memory.evidence)
    clear(memory, memory.trust.blocked)
    memory.trust = memory.trust._replace(blocked="")
    if memory.trust.doubt.times > 0.0:
        report(memory, "lvdt_doubted", lvdt.TEXTS["doubted"])
    hold_here(p, memory, reading)
    take_over(p, memory, memory.former, False)
    return True


def hold_here(p: Params, memory: Memory, reading: float) -> None:
    """Let the law hold the valve at ``reading`` [V] until a command comes."""
    clear(memory, "lvdt_missing")
    memory.command = command_watch.held_here(p.command, memory.command, reading, memory.now)
    if memory.command.homing is not None:
        report(memory, "command_silent", command_watch.SILENT)
    if memory.command.value is None:
        report(memory, "command_missing", "no command yet")


def begin(p: Params, memory: Memory, reading: float) -> None:
    """Start the law: as offline if all is at rest, without a bump if spool or command are elsewhere."""
    memory.measurement = reading
    memory.velocity = tachometer.State(reading, 0.0)
    memory.voltage = p.neutral
    hold_here(p, memory, reading)
    wanted = 0.0 if memory.command.value is None else memory.command.value
    if p.lockstep or max(abs(reading), abs(wanted)) <= p.lvdt.judge.tolerance:
        memory.law = law_initial(p.law, Start(reading, memory.voltage, reading, 0.0, 0.0))
    else:
        take_over(p, memory, None, False)


def take_over(p: Params, memory: Memory, former: Any | None, following: bool) -> None:
    """Start the law where the spool is, with the estimates of its ``former`` state.

    ``following``: the spool has been following the command until now.
    """
    follow(p, memory, memory.now)
    y, v = memory.measurement, memory.velocity.velocity
    start = Start(y, memory.voltage, y, v, v)
    base = target(p, memory)  # which may end a way home and begin an offset
    base -= memory.transfer.command.value
    held, left = law_steady_command(p.law, start), 0.0
    # A spool that follows has the rate of the command; one from elsewhere has to lose its own.
    offset = bumpless_transfer.Offset(held - base, 0.0)
    if not following:
        offset, left = bumpless_transfer.Offset(0.0, v), bumpless_transfer.JOINING * p.transfer.time
    law = p.law if former is None else law_resumed(p.law, former)
    memory.law = law_initial(law, start)
    memory.transfer = bumpless_transfer.State(memory.transfer.voltage, offset, True, held, left)
    memory.fading = True


def go_on(p: Params, memory: Memory, former: Any, reference: Any) -> None:
    """Start the law where the spool is, with the estimates of the ``former`` state of another.

    ``reference``: the one that this law followed, with its rate.
    """
    follow(p, memory, memory.now)
    y, v = memory.measurement, memory.velocity.velocity
    start = Start(y, memory.voltage, reference.reference, reference.rate, v)
    target(p, memory)
    memory.law = law_initial(law_resumed(p.law, former), start)
    memory.transfer = memory.transfer._replace(taking_over=True)
    memory.fading = True


# The law


def advance(p: Params, memory: Memory, gap: int, reading: float) -> bool:
    """Run ``hold`` over a ``gap`` before ``reading`` [V], or ``control`` if there is none, and catch errors.

    False if it produced NaN or infinity, or raised an error: C goes on with what it computes instead.
    """
    try:
        if gap > 0:
            hold(p, memory, gap, reading)
            return True
        return control(p, memory, reading)
    except Exception as error:  # a law of another package may raise any
        text = f"the control law {memory.name} raised {in_words(error)} after {memory.now:.3f} s"
        report(memory, "law_not_finite", text)
        return False


def hold(p: Params, memory: Memory, gap: int, reading: float) -> None:
    """Step the law over ``gap`` samples without a reading, on a straight line to ``reading`` [V]."""
    slope = (reading - memory.measurement) / (gap + 1)
    newest, used = memory.command.value, memory.used
    for i in range(1, gap + 1):
        between = memory.measurement + i * slope
        now = memory.now - (gap + 1 - i) * p.lvdt.period
        if memory.trajectory is not None or (
            memory.course is not None and memory.course.stamp != memory.course.sent
        ):
            follow(p, memory, now)
        elif newest is not None and used is not None and memory.command.homing is None:
            memory.command = memory.command._replace(value=used + i * (newest - used) / (gap + 1))
        memory.velocity = tachometer.step(p.lvdt.tachometer, memory.velocity, between)
        wanted = taken_in(p, memory)
        memory.law = law_hold(p.law, memory.law, wanted, between, memory.voltage)
        if memory.fading:
            fade(p, memory)


def control(p: Params, memory: Memory, reading: float) -> bool:
    """Compute one step of the law and give its voltage; False, and none, if it is not finite."""
    law = p.law
    if memory.trust.doubt.times != 0.0 and p.lvdt.comparison is not None:
        law = law._replace(u_max=min(law.u_max, p.probation))
    follow(p, memory, memory.now)
    wanted = taken_in(p, memory)
    memory.effective = wanted
    memory.used = memory.command.value
    if memory.transfer.taking_over:
        _, _, first = law_step(law, memory.law, wanted, reading, 0.0)
        offset = bumpless_transfer.Offset(memory.voltage - first.unsaturated_voltage, 0.0)
        memory.transfer = memory.transfer._replace(voltage=offset, taking_over=False)
        memory.fading = True
    voltage, after, terms = law_step(law, memory.law, wanted, reading, memory.transfer.voltage.value)
    if not are_finite(voltage, terms):
        return False
    memory.voltage = voltage
    give_voltage(amplified(p, voltage))
    memory.law = after
    observe(memory, terms, voltage)
    if memory.fading:
        fade(p, memory)
    return True


def fade(p: Params, memory: Memory) -> None:
    """Let both offsets of a takeover decay by one period."""
    memory.transfer = bumpless_transfer.step(p.transfer, memory.transfer)
    voltage, command = memory.transfer.voltage, memory.transfer.command
    memory.fading = memory.transfer.left > 0.0 or (
        voltage.value != 0.0 or voltage.rate != 0.0 or command.value != 0.0 or command.rate != 0.0
    )


def follow(p: Params, memory: Memory, now: float) -> None:
    """The command in force is that of trajectory or course at ``now`` [s], if there is one."""
    if memory.trajectory is not None:
        memory.motion = points.motion(p.course, memory.trajectory, now)
        memory.command = command_watch.moved(memory.command, memory.motion.position)
    elif memory.course is not None and memory.command.homing is None:
        memory.command = command_watch.moved(
            memory.command, command_course.value(p.course, memory.course, now)
        )


def taken_in(p: Params, memory: Memory) -> float:
    """Command [V] of this sample as the law gets it, after its lead has followed it."""
    value = memory.command.value
    if memory.trajectory is not None:
        memory.lead = None
    elif p.lead is not None and value is not None:
        before = command_lead.initial(value) if memory.lead is None else memory.lead
        memory.lead = command_lead.step(p.lead, before, value)
    wanted = target(p, memory)
    return bumpless_transfer.joined(p.transfer, memory.transfer, wanted)


def target(p: Params, memory: Memory) -> float:
    """Command [V] of this sample, with its lead or its derivatives, and with its offset."""
    homing = memory.command.homing is not None
    wanted, memory.command, offset = command_watch.step(
        p.command, memory.command, memory.transfer.command, memory.now
    )
    if homing != (memory.command.homing is not None):
        if homing:
            memory.transfer = memory.transfer._replace(command=offset)
            memory.fading = True
            clear(memory, "command_silent")
        else:
            report(memory, "command_silent", command_watch.SILENT)
    value = memory.command.value
    if value is None or memory.command.homing is not None:
        return wanted
    if memory.trajectory is not None and p.reshapes:
        return law_commanded(p.law, memory.motion) + memory.transfer.command.value
    if p.lead is None or memory.lead is None:
        return wanted
    return command_lead.led(p.lead, memory.lead, value) + memory.transfer.command.value
