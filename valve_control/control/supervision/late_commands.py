# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bridges a command that is late: the motion goes on by its derivatives, and joins what comes without a kink.

The derivatives of bare commands are those of a cubic through the newest command and three nodes before it.
At 1 kHz the nodes count as 5 ms apart, which smooths noise. After ``time`` without a message the motion
returns to the last one and rests. The distance to a message that comes late decays with its rate and
acceleration, so that the law sees no step in any of the three (docs/howto/cascade.md).
"""

import math
from typing import NamedTuple

from valve_control.control.laws.projection import clip
from valve_control.control.plant.amplifier import saturate
from valve_control.parameter import Values, number, word

LONGEST = 0.1  # s between two commands of one course; one that comes later begins anew
UNEVEN = 0.02  # s  early or late by which a command still belongs to the course
SMOOTHING = 0.1  # share of what a command comes early or late that counts
LATE = 1.5  # intervals after which a message is late
SHORT = 2.5  # periods, up to which a command is late on its way rather than at its sender
NODE = 0.005  # s  least distance of the nodes
SAME = 0.05  # of the usual interval, below which two messages are one node
ENOUGH = 4  # messages from which on a motion is known
USUAL = 0.05  # share of an interval in the usual one
JOINING = 1.4  # rate times the bridged time, of the decay of the distance from what comes late
RETURNING = 0.5  # the same from the last message, if none comes
TAKEN_BACK = 0.1  # of an offset, from which on a command takes it back
BEGIN = 0.25  # of what the limit of the acceleration allows, that counts as motion after rest
DECAYED = 20.0  # time constants after which nothing is left
NOTHING = -1.0  # s  time of an offset that is not


class Motion(NamedTuple):
    """Of one moment."""

    position: float  # V
    velocity: float  # V/s
    acceleration: float  # V/s²


class Params(NamedTuple):
    """For how long a motion goes on, and its limits."""

    time: float  # s  after a message was due
    every: bool  # whether the motion goes on between all messages, also those in time
    limit: float  # V
    max_rate: float  # V/s
    max_accel: float  # V/s²
    period: float  # s  ΔT


class Offset(NamedTuple):
    """Distance from the messages, on its way to 0."""

    value: Motion
    since: float  # s  NOTHING: there is none


class Fit(NamedTuple):
    """A cubic at a moment."""

    motion: Motion
    jerk: float  # V/s³


class State(NamedTuple):
    """The newest command, and the motion that it belongs to."""

    fit: Fit  # at the newest command
    due: float  # s  when that was due
    base: Fit  # at the node before
    first: float  # s  from the node before to the newest command
    second: float  # s  between the two nodes before
    third: float  # s  between the two before these
    interval: float  # s  usual time between two commands
    known: int  # commands of this motion, up to ENOUGH
    offset: Offset
    slipped: bool  # whether it came from a command that was late on its way


REST = Motion(0.0, 0.0, 0.0)
NO_OFFSET = Offset(REST, NOTHING)


def design(values: Values) -> Params | None:
    """Params from the controller's values; None where nothing is bridged."""
    time, kind = number(values, "command.bridge"), word(values, "command.interpolation")
    if time == 0.0:
        return None
    return Params(
        time,
        kind == "bridge",
        number(values, "command_limit"),
        number(values, "reshaping.max_rate"),
        number(values, "reshaping.max_accel"),
        number(values, "sample_period"),
    )


# Motions


def after(m: Motion, jerk: float, time: float) -> Motion:
    """Motion ``m`` under a constant ``jerk`` [V/s³], ``time`` [s] later."""
    bend = m.acceleration + jerk * time
    rate = m.velocity + (m.acceleration + 0.5 * jerk * time) * time
    way = (m.velocity + (0.5 * m.acceleration + jerk * time / 6.0) * time) * time
    return Motion(m.position + way, rate, bend)


def between(a: Motion, b: Motion) -> Motion:
    """The motion by which ``a`` is away from ``b``."""
    return Motion(a.position - b.position, a.velocity - b.velocity, a.acceleration - b.acceleration)


def together(a: Motion, b: Motion) -> Motion:
    """The sum of two motions."""
    return Motion(a.position + b.position, a.velocity + b.velocity, a.acceleration + b.acceleration)


def faded(m: Motion, rate: float, time: float) -> Motion:
    """A distance ``m`` from rest, ``time`` [s] later: (d/dt + rate)³ x = 0."""
    if rate * time > DECAYED:
        return REST
    first = m.velocity + rate * m.position
    second = 0.5 * (m.acceleration + rate * (2.0 * m.velocity + rate * m.position))
    left = math.exp(-rate * time)
    way = m.position + (first + second * time) * time
    slope = first + 2.0 * second * time
    return Motion(
        way * left,
        (slope - rate * way) * left,
        (2.0 * second - rate * (2.0 * slope - rate * way)) * left,
    )


def continued(p: Params, m: Motion, jerk: float, home: float, time: float, until: float) -> Motion:
    """Motion ``m``, ``time`` [s] later: after ``until`` [s] it returns to ``home`` [V]."""
    if time <= until:
        return after(m, jerk, time)
    end = after(m, jerk, until)
    left = faded(
        Motion(end.position - home, end.velocity, end.acceleration), RETURNING / p.time, time - until
    )
    return Motion(home + left.position, left.velocity, left.acceleration)


def with_offset(p: Params, m: Motion, offset: Offset, now: float) -> Motion:
    """Motion ``m`` with what is left of ``offset`` at ``now`` [s]."""
    rate = JOINING / p.time
    if offset.since == NOTHING or rate * (now - offset.since) > DECAYED:
        return m
    return together(m, faded(offset.value, rate, now - offset.since))


def rejoined(p: Params, was: Motion, left: Offset, course: Motion, elapsed: float, now: float) -> Offset:
    """Offset with which ``course`` begins at ``now`` [s]; ``was``: the one before, with what is ``left``.

    None after a step: both courses are farther apart than the motion goes meanwhile and the limit of the
    acceleration allows, from rest to rest, in the time ``elapsed`` [s] since the message before.
    """
    half = 0.5 * max(elapsed, NODE)
    timing = abs(was.velocity) * max(elapsed, 2.0 * NODE)
    if abs(was.position - course.position) > timing + p.max_accel * half * half:
        return NO_OFFSET
    return Offset(between(with_offset(p, was, left, now), course), now)


def joined(due: float, interval: float, arrival: float) -> float:
    """When [s] a message is due that was sent ``interval`` [s] after the one that was due at ``due`` [s]."""
    late = arrival - due - interval
    return arrival if abs(late) > max(interval, UNEVEN) else due + interval + SMOOTHING * late


def usual(interval: float, elapsed: float) -> float:
    """The usual ``interval`` [s] after one of ``elapsed`` [s] more."""
    return interval + USUAL * (min(elapsed, 3.0 * interval) - interval)


# Bare commands


def begun(command: float, arrival: float) -> State:
    """A ``command`` [V] at rest."""
    fit = Fit(Motion(command, 0.0, 0.0), 0.0)
    return State(fit, arrival, fit, 0.0, 0.0, 0.0, 0.0, 1, NO_OFFSET, False)


def fitted(
    p: Params, base: Fit, command: float, first: float, second: float, third: float, interval: float
) -> Fit:
    """The cubic through ``command`` [V], ``first`` [s] after ``base``, and through the nodes of ``base``.

    Of a step only as much counts as motion as has been seen of motion before.
    """
    ahead = after(base.motion, base.jerk, first)
    b = base.motion
    span, least = max(first, interval), NODE if interval < NODE else 0.0
    seen = span * (abs(b.velocity) + span * (0.5 * abs(b.acceleration) + span * abs(base.jerk) / 6.0))
    most = seen + BEGIN * p.max_accel * p.period * span
    missed = clip(command - ahead.position, -most, most)
    near = max(first, least)
    middle = near + max(second, least)
    one, two, three = 1.0 / near, 1.0 / middle, 1.0 / (middle + max(third, least))
    rate = ahead.velocity + missed * (one + two + three)
    bend = ahead.acceleration + 2.0 * missed * (one * (two + three) + two * three)
    jerk = base.jerk + 6.0 * missed * one * two * three
    most_jerk = p.max_accel / p.time
    within = Motion(command, clip(rate, -p.max_rate, p.max_rate), clip(bend, -p.max_accel, p.max_accel))
    return Fit(within, clip(jerk, -most_jerk, most_jerk))


def taken(p: Params, s: State | None, command: float, interval: float, arrival: float) -> State:
    """A ``command`` [V] has come for the sample at ``arrival`` [s].

    ``interval`` [s] after the one before by their time stamps, which counts where every message is joined;
    otherwise they are one for each sample.
    """
    if s is None:
        return begun(command, arrival)
    elapsed = interval if p.every else arrival - s.due
    if elapsed < 0.0 or elapsed > LONGEST or (p.every and elapsed == 0.0):
        return begun(command, arrival)
    same = s.known > 1 and elapsed <= SAME * s.interval
    base = s.base if same else s.fit
    first = s.first + elapsed if same else elapsed
    if first <= 0.0:
        return begun(command, arrival)
    second = s.second if same else s.first
    third = s.third if same else s.second
    if s.known < ENOUGH:
        second = first if second <= 0.0 else second
        third = second if third <= 0.0 else third
    typical = usual(s.interval, elapsed) if s.known > 1 else elapsed
    fit = fitted(p, base, command, first, second, third, typical)
    due = joined(s.due, elapsed, min(arrival, s.due + elapsed + typical)) if p.every else arrival
    made = State(fit, due, base, first, second, third, typical, min(s.known + 1, ENOUGH), s.offset, s.slipped)
    missed = expects(p, s) and arrival > s.due + LATE * p.period
    again = s.due == arrival and s.offset.since == arrival
    back = s.slipped and made_up_for(p, s, made, arrival)
    if p.every or missed or again or back:
        was, now = course(p, s, arrival), course(p, made, arrival)
        slipped = (missed and arrival - s.due < SHORT * p.period) or ((again or back) and s.slipped)
        if slipped:
            # What it comes early or late on its way is no motion.
            now = Motion(now.position, was.velocity, was.acceleration)
        offset = rejoined(p, was, s.offset, now, arrival - s.due, arrival)
        return made._replace(offset=offset, slipped=slipped)
    return made


def made_up_for(p: Params, s: State, made: State, now: float) -> bool:
    """Whether the newest command, in time again, takes back what is left of the offset or a part of it."""
    if s.offset.since == NOTHING or not expects(p, s):
        return False
    left = with_offset(p, REST, s.offset, now).position
    change = course(p, s, now).position - course(p, made, now).position
    return abs(change) > TAKEN_BACK * abs(left) > abs(left + change) * TAKEN_BACK


def expects(p: Params, s: State) -> bool:
    """Whether there is a command for every sample, as far as is known."""
    return s.known >= ENOUGH and s.interval < LATE * p.period


def course(p: Params, s: State, now: float) -> Motion:
    """The motion at ``now`` [s], without the offset."""
    here, time = s.fit.motion, max(0.0, now - s.due)
    if not p.every and not expects(p, s):
        return Motion(here.position, 0.0, 0.0)
    if not p.every and time < 0.5 * p.period:
        return here
    return continued(p, here, s.fit.jerk, here.position, time, p.time + s.interval)


def value(p: Params, s: State, now: float) -> float:
    """Command [V] of the sample at ``now`` [s]."""
    if s.offset.since == NOTHING and not p.every and now - s.due < 0.5 * p.period:  # in time: quicker
        return saturate(s.fit.motion.position, p.limit)
    return saturate(with_offset(p, course(p, s, now), s.offset, now).position, p.limit)


def after_gap(s: State, before: float, now: float) -> State:
    """State at ``now`` [s] after readings were lost since ``before`` [s]: what came meanwhile is of now."""
    return s._replace(due=now) if s.due > before else s
