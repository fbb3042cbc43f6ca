# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Course of the command: the upper level's motion at the time of a reading.

Commands are samples of a motion at the times at which they were sent. Four predictors continue it from the
newest: hold; two cubics of fading memory, which smooth noise; the quintic through the last six commands.
Each counts by how well it has predicted the last commands: the inverse square of its mean square error. So
noise and staircases are held, as they are sent, and a smooth motion is continued with its derivatives. A
command that no predictor explains is a step: it takes effect at once, and no derivative is made of it
(docs/explanation/command_course.md).
"""

import math
from typing import NamedTuple

from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Values, number

LONGEST = 0.1  # s  between two commands of one course; one that comes later begins anew
USUAL = 0.05  # share of an interval in the usual one
LATE = 1.5  # usual intervals after which a command is late
MEMORIES = (0.65, 0.3)  # θ of the two fading memories, for each command
FORGETTING = 0.7  # of the square errors, for each command
PREFERENCE = 4.0  # weight of hold at equal errors
STEP = 10.0  # times the rms error of the best predictor, beyond which a command is a step
PART = 0.1  # of the last changes of the command, which a step is larger than
FLOOR = 1e-6  # V  error that is none
LEAST = FLOOR * FLOOR  # V²  mean square error of a predictor that has made none
ENOUGH = 4  # commands after which a course is no longer at its beginning
GONE = 10.0  # times the time of the bridge, after which nothing is left of the motion


class Motion(NamedTuple):
    """Of one moment."""

    position: float  # V
    velocity: float  # V/s
    acceleration: float  # V/s²


class Params(NamedTuple):
    """For how long a motion goes on, and how far behind the law follows it."""

    bridge: float  # s  after a command was due
    lag: float  # s
    limit: float  # V
    period: float  # s  ΔT


class Course(NamedTuple):
    """A polynomial at the time of the newest command."""

    position: float  # V
    velocity: float  # V/s
    acceleration: float  # V/s²
    jerk: float  # V/s³
    snap: float  # V/s⁴
    crackle: float  # V/s⁵


def _fading(memory: float) -> Course:
    """Gains of the fading memory of degree 3 for each derivative, times the interval's power.

    Morrison, Introduction to Sequential Smoothing and Prediction (1969).
    """
    rest = 1.0 - memory
    velocity = rest**2 * (11.0 + 14.0 * memory + 11.0 * memory**2) / 6.0
    return Course(1.0 - memory**4, velocity, 2.0 * rest**3 * (1.0 + memory), rest**4, 0.0, 0.0)


SMOOTH, QUICK = _fading(MEMORIES[0]), _fading(MEMORIES[1])
# Of the polynomial through six commands, by Newton's backward differences: k!·e_k(1, 1/2, … 1/5)
EXACT = Course(1.0, 137.0 / 60.0, 15.0 / 4.0, 17.0 / 4.0, 3.0, 1.0)


class State(NamedTuple):
    """The newest command, and the predictors with their errors."""

    command: float  # V
    sent: float  # s  on the clock of the samples
    stamp: float  # s  on the sender's clock; without one as ``sent``
    interval: float  # s  usual time between two commands
    change: float  # V  from the command before
    known: int  # commands of this course, up to one more than ENOUGH
    leapt: bool  # whether this one was a step
    smooth: Course
    quick: Course
    exact: Course
    held_error: float  # V²  fading sum of the square errors of each predictor
    smooth_error: float  # V²
    quick_error: float  # V²
    exact_error: float  # V²


class Horizon(NamedTuple):
    """A time ahead of the newest command, as a function of time."""

    time: float  # s
    rate: float  # -  its derivative
    bend: float  # 1/s


def design(values: Values) -> Params:
    """Params from the controller's values."""
    return Params(
        number(values, "command.bridge"),
        number(values, "command.lag"),
        number(values, "command_limit"),
        number(values, "sample_period"),
    )


def begun(p: Params, command: float, sent: float, stamp: float) -> State:
    """A ``command`` [V] at rest, the first of a course."""
    rest = resting(command)
    return State(command, sent, stamp, p.period, 0.0, 1, False, rest, rest, rest, LEAST, LEAST, LEAST, LEAST)


def taken(p: Params, s: State | None, command: float, sent: float, stamp: float) -> State:
    """A ``command`` [V] has come; it was ``sent`` [s], by its sender's clock at ``stamp`` [s]."""
    if s is None:
        return begun(p, command, sent, stamp)
    elapsed = stamp - s.stamp
    if abs(elapsed) > LONGEST:
        return begun(p, command, sent, stamp)
    if elapsed <= 0.0:  # of the same moment: the newest counts
        smooth, quick, exact = moved(s.smooth, command), moved(s.quick, command), moved(s.exact, command)
        return State(
            command, sent, s.stamp, s.interval, s.change, s.known, s.leapt, smooth, quick, exact,
            s.held_error, s.smooth_error, s.quick_error, s.exact_error,
        )  # fmt: skip
    interval = (
        max(elapsed, p.period)
        if s.known == 1
        else s.interval + USUAL * (min(elapsed, 3.0 * s.interval) - s.interval)
    )
    smooth, quick, exact = after(s.smooth, elapsed), after(s.quick, elapsed), after(s.exact, elapsed)
    held = command - s.command
    rough, near, fine = command - smooth.position, command - quick.position, command - exact.position
    far, off, aside, beyond = abs(held), abs(rough), abs(near), abs(fine)
    least = min(far, off, aside, beyond)
    usual = math.sqrt(min(s.held_error, s.smooth_error, s.quick_error, s.exact_error))
    leaps = least > STEP * usual and least > PART * max(far, abs(s.change))
    leapt, known, common = leaps and not s.leapt, s.known, 0.0
    if leapt:
        common = least
    else:
        known = 2 if leaps else min(s.known + 1, ENOUGH + 1)
    worst = 4.0 * p.limit * p.limit
    held_error = faded(s.held_error, far - common, worst)
    smooth_error = faded(s.smooth_error, off - common, worst)
    quick_error = faded(s.quick_error, aside - common, worst)
    exact_error = faded(s.exact_error, beyond - common, worst)
    # A course that misses commands by more than a motion can begins at rest: the gains are those of even
    # intervals, and with others the polynomial through six commands may be unstable.
    count = 0 if leapt else known
    span = max(elapsed, 0.5 * interval)
    change = held / span
    smooth = renewed(smooth, SMOOTH, command, rough, change, span, 1 if smooth_error >= worst else count)
    quick = renewed(quick, QUICK, command, near, change, span, 1 if quick_error >= worst else count)
    exact = renewed(exact, EXACT, command, fine, change, span, 1 if exact_error >= worst else count)
    return State(
        command, sent, stamp, interval, held, known, leapt, smooth, quick, exact,
        held_error, smooth_error, quick_error, exact_error,
    )  # fmt: skip


def postponed(s: State, now: float) -> State:
    """State whose newest command, which has no time stamp, is of ``now`` [s]."""
    return s._replace(sent=now, stamp=now)


def faded(error: float, missed: float, worst: float) -> float:
    """Fading sum of the square errors [V²], after one more error [V]; ``worst`` at most."""
    after_it = FORGETTING * error + missed * missed + LEAST
    return after_it if after_it < worst else worst


def resting(command: float) -> Course:
    """Rest at ``command`` [V]."""
    return Course(command, 0.0, 0.0, 0.0, 0.0, 0.0)


# Predictors


def after(c: Course, time: float) -> Course:
    """The course ``c``, ``time`` [s] later."""
    t = time
    x, v, a, j, s, q = c
    return Course(
        x + t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0 + t * q / 120.0)))),
        v + t * (a + t * (j / 2.0 + t * (s / 6.0 + t * q / 24.0))),
        a + t * (j + t * (s / 2.0 + t * q / 6.0)),
        j + t * (s + t * q / 2.0),
        s + t * q,
        q,
    )


def position(c: Course, time: float) -> float:
    """Position [V] of the course ``c``, ``time`` [s] later."""
    t = time
    x, v, a, j, s, q = c
    return x + t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0 + t * q / 120.0))))


def moved(c: Course, command: float) -> Course:
    """The course ``c`` from ``command`` [V] on, with the same derivatives."""
    return Course(command, c.velocity, c.acceleration, c.jerk, c.snap, c.crackle)


def renewed(
    c: Course, gains: Course, command: float, missed: float, change: float, span: float, count: int
) -> Course:
    """The course ``c`` after a ``command`` [V] that it ``missed`` [V], ``span`` [s] after the one before.

    ``count``: of commands that it goes through; 0: it is moved by a step; 1: it begins at rest; 2: with
    ``change`` [V/s]; above ENOUGH it is corrected by the ``gains`` of its derivatives.
    """
    if count == 0:
        return moved(c, command)
    if count == 1:
        return resting(command)
    if count == 2:
        return Course(command, change, 0.0, 0.0, 0.0, 0.0)
    rate = missed / span
    bend = rate / span
    if count == 3:
        return Course(command, c.velocity + 1.5 * rate, c.acceleration + bend, 0.0, 0.0, 0.0)
    jerk = bend / span
    if count <= ENOUGH:
        return Course(
            command, c.velocity + 11.0 / 6.0 * rate, c.acceleration + 2.0 * bend, c.jerk + jerk, 0.0, 0.0
        )
    snap = jerk / span
    return Course(
        c.position + gains.position * missed,
        c.velocity + gains.velocity * rate,
        c.acceleration + gains.acceleration * bend,
        c.jerk + gains.jerk * jerk,
        c.snap + gains.snap * snap,
        c.crackle + gains.crackle * snap / span,
    )


# The motion at the time of a reading


def horizon(bridge: float, interval: float, time: float) -> Horizon:
    """How far ahead of the newest command the motion is followed, ``time`` [s] after it was sent.

    As far as that, until a command is late by ``bridge`` [s]; then back to it without a kink.
    """
    until = LATE * interval + bridge
    beyond = time - until
    if beyond <= 0.0:
        return Horizon(max(time, -LONGEST), 1.0, 0.0)
    if beyond > GONE * until:
        return Horizon(0.0, 0.0, 0.0)
    rate = 2.0 / until
    left = math.exp(-rate * beyond)
    way = until + beyond * (3.0 + 4.0 * beyond / until)
    slope = 3.0 + 8.0 * beyond / until
    return Horizon(
        way * left, (slope - rate * way) * left, (8.0 / until - rate * (2.0 * slope - rate * way)) * left
    )


def value(p: Params, s: State, now: float) -> float:
    """Command [V] of the sample at ``now`` [s]; that of a command which was sent for it, to the bit."""
    time = now - p.lag - s.sent
    if time == 0.0:
        return saturate(s.command, p.limit)
    ahead = time
    if time < -LONGEST or time > LATE * s.interval + p.bridge:  # else quicker than ``horizon``
        ahead = horizon(p.bridge, s.interval, time).time
    if ahead == 0.0:
        return saturate(s.command, p.limit)
    one = PREFERENCE / (s.held_error * s.held_error)
    two = 1.0 / (s.smooth_error * s.smooth_error)
    three = 1.0 / (s.quick_error * s.quick_error)
    four = 1.0 / (s.exact_error * s.exact_error)
    away = two * (position(s.smooth, ahead) - s.command) + three * (position(s.quick, ahead) - s.command)
    away += four * (position(s.exact, ahead) - s.command)
    return saturate(s.command + away / (one + two + three + four), p.limit)
