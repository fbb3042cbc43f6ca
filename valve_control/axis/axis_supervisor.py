# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the upper level of an axis: follows paths, holds a position without one, and stops on a fault.

Three modes, as of the valve's supervisor:

ok        the axis follows its path, or holds its position;
degraded  the same, but something is reported: a goal or a trajectory was refused, readings are bridged;
safe      stopped: 0 V is commanded until ``reset``, because the sensors cannot be believed, the axis does not
          follow, or somebody asked for it.
"""

import math
import types
from typing import Any, NamedTuple

from valve_control.axis import axis_parameters as parameters
from valve_control.axis import axis_pid, axis_watch, path, upper
from valve_control.axis.course import Goal
from valve_control.axis.machine import Reading
from valve_control.axis.path import Path
from valve_control.control.supervision.memory import Mode
from valve_control.parameter import ParameterError, Values, number, word

NANO = 1e-9
REPORTED = 1.0  # s for which a refusal stays reported
LEAP = 1.0  # s by which the stamps of two readings may differ; farther, or backwards, a clock was set


class Params(NamedTuple):
    """The upper level and what is watched."""

    level: types.ModuleType  # the upper level, of upper.LEVELS
    upper: Any
    watch: axis_watch.Params
    error_limit: float  # m  0.0: none
    period: float  # s


class State(NamedTuple):
    """All that is remembered between two samples."""

    upper: Any
    terms: Any
    watch: axis_watch.State = axis_watch.UNKNOWN
    path: Path | None = None
    begun: int | None = None  # ns  time of the path's beginning, None: with the next reading
    later: tuple[Path, int] | None = None  # path that replaces the one in motion, and its beginning [ns]
    goal: Goal | None = None  # None before the first reading
    jerk: float = 0.0  # m/s³  of the goal
    command: float = 0.0  # V
    stopped: str = ""  # why; "": it is not
    bridged: str = ""  # what is wrong with the reading that is bridged
    refused: str = ""  # what was refused of late
    refused_until: float = 0.0  # samples
    time: int = 0  # ns  of the last reading
    samples: int = 0


def design(values: Values) -> tuple[Params, path.Range]:
    """Params from the values of ``axis_controller``, and what the axis can do. Raises ParameterError."""
    machine = word(values, "machine")
    if not machine:
        raise ParameterError(
            "machine is empty; it must name a file in config/axis, or be the path of a parameter file, from "
            "which stroke and velocity gains are taken"
        )
    known = parameters.known_machine(machine)
    if number(known, "sample_period") != number(values, "sample_period"):
        raise ParameterError(
            f"sample_period is {number(known, 'sample_period'):g} s for the machine '{machine}' and "
            f"{number(values, 'sample_period'):g} s for axis_controller; they must be equal"
        )
    built = parameters.axis_params(known)
    moved = axis_pid.build(values, *parameters.velocity_gains(built, known))
    low, high, beyond = 0.0, built.cylinder.stroke, moved.limit - moved.overlap
    if beyond <= 0.0:
        raise ParameterError(f"overlap is {moved.overlap:g} V, no less than spool_limit, {moved.limit:g} V")
    level = upper.LEVELS[word(values, "upper_level")]
    watch = axis_watch.Params(
        low,
        high,
        number(values, "sensor.tolerance"),
        number(values, "sensor.max_speed"),
        number(values, "sensor.pressure_high"),
        number(values, "sensor.pressure_jump"),
        int(number(values, "sensor.hold_samples")),
    )
    able = path.Range(
        low, high, moved.gain_out * beyond, moved.gain_in * beyond, number(values, "start_tolerance")
    )
    made = parameters.upper_level(values, built, known)
    return Params(level, made, watch, number(values, "error_limit"), number(values, "sample_period")), able


def at_rest(p: Params) -> State:
    """Before the first reading."""
    return State(p.level.initial(p.upper), p.level.AT_REST)


def mode(s: State) -> tuple[Mode, str]:
    """Mode and reason."""
    if s.stopped:
        return Mode.SAFE, f"stopped, 0 V: {s.stopped}"
    if s.goal is None:
        return Mode.DEGRADED, "no position reading yet"
    if s.bridged:
        return Mode.DEGRADED, f"{s.bridged}; the last command holds"
    if s.samples < s.refused_until:
        return Mode.DEGRADED, s.refused
    return Mode.OK, "holds its position" if s.path is None else "follows its path"


def stopped(s: State, why: str) -> State:
    """State after a stop; the first reason stays."""
    return s if s.stopped else s._replace(stopped=why, command=0.0, path=None, later=None, bridged="")


def reset(p: Params, s: State) -> State:
    """State that holds the position of the next reading, whatever was before."""
    return at_rest(p)._replace(samples=s.samples)


def refused(p: Params, s: State, text: str) -> State:
    """State that reports a refusal."""
    return s._replace(refused=text, refused_until=s.samples + REPORTED / p.period)


def moves(s: State) -> bool:
    """Whether the axis follows a path that has begun."""
    return s.path is not None and s.begun is not None and s.begun <= s.time


def begin(s: State, new: path.Path, at: int | None) -> State:
    """State that follows a ``new`` path from the time ``at`` [ns] on, or from the next reading on.

    A motion goes on until then. The present goal of an axis in motion is that of the last reading, with which
    the new path begins.
    """
    if moves(s):
        if at is None:
            at = s.time
        elif at > s.time:
            return s._replace(later=(new, at))
    return s._replace(path=new, begun=at, later=None)


def present(s: State, at: int | None = None) -> Goal | None:
    """Goal at which a new path begins, at the time ``at`` [ns] or now; None while there is none to be had."""
    if s.stopped or at is None or at <= s.time or not moves(s):
        return None if s.stopped else s.goal
    assert s.path is not None and s.begun is not None
    return path.goal_of(s.path, at - s.begun)


def joining(s: State, new: path.Path, at: int | None, able: path.Range) -> path.Path:
    """The ``new`` path if it may begin at the time ``at`` [ns]. Raises ParameterError for one long begun."""
    if at is None or at >= s.time or s.goal is None:
        return new
    leap = abs(path.goal_of(new, s.time - at).position - s.goal.position)
    if leap > able.start:
        raise ParameterError(
            f"the trajectory began {(s.time - at) * NANO:.4g} s ago and is now {leap:.4g} m from the present "
            f"goal at {s.goal.position:.4g} m; {able.start:g} m are allowed"
        )
    return new


def found(p: Params, s: State, position: float, time: int = 0) -> State:
    """State before the first sample: the axis is at ``position`` [m], which is its goal if it is believed.

    ``time`` [ns]: of that reading, 0 if it is not known; a trajectory that has begun before is late.
    """
    if s.stopped or axis_watch.position_fault(p.watch, s.watch, position, 0.0):
        return s
    return s._replace(goal=Goal(position, 0.0, 0.0), time=time or s.time)


def moved_on(p: Params, s: State, time: int) -> State:
    """State whose paths begin earlier or later, by as much as the clock was set before ``time`` [ns]."""
    if s.time == 0 or s.time <= time <= s.time + round(LEAP / NANO):
        return s
    leap = time - s.time - round(p.period / NANO)
    begun = None if s.begun is None else s.begun + leap
    return s._replace(begun=begun, later=None if s.later is None else (s.later[0], s.later[1] + leap))


def passed(p: Params, time: float) -> int:
    """Sample periods within ``time`` [s] between two readings, by their stamps; 1 where a clock was set."""
    return max(1, round(time / p.period)) if time <= LEAP else 1


def unstamped(p: Params, s: State, lost: int | None) -> int:
    """Time [ns] of a reading without a stamp; ``lost`` ones before it count if they can be bridged."""
    counted = lost if lost is not None and lost <= p.watch.hold_samples else 0
    return s.time + (1 + counted) * round(p.period / NANO)


def missed(p: Params, elapsed: float, lost: int | None) -> int:
    """Readings that did not come within ``elapsed`` [s], by the stamps, between two that did.

    ``lost``: as many by their numbers, None if these are not known. A stamp may be late, so the numbers count
    unless they differ from the stamps by a period or more: a sensor may leave out samples, or number others'.
    """
    if lost is not None and elapsed <= LEAP and abs(lost + 1 - elapsed / p.period) < 1.0:
        return lost
    return passed(p, elapsed) - 1


def sample(p: Params, s: State, reading: Reading, time: int, lost: int | None = None) -> State:
    """State after a ``reading`` made at ``time`` [ns]; its ``command`` is that of this sample.

    ``lost``: readings that did not come before it, by their numbers; None: not known.
    """
    elapsed = (time - s.time) * NANO if s.samples > 0 else p.period
    if not elapsed > 0.0:
        elapsed = p.period
    both = (reading.pressure_a, reading.pressure_b) if p.level.NEEDS_PRESSURES else None
    if s.goal is None:
        s = found(p, s, reading.position)
    periods = passed(p, s.watch.age + elapsed)  # since the goal last moved
    fault, watch = axis_watch.step(p.watch, s.watch, reading.position, both, elapsed)
    s = moved_on(p, s, time)._replace(watch=watch, time=time, samples=s.samples + 1)
    if s.stopped:
        return s
    for _ in range(missed(p, elapsed, lost)):
        s = s._replace(upper=p.level.missed(p.upper, s.upper))
    if fault:
        if s.goal is None or watch.wrong > p.watch.hold_samples:
            return stopped(s, fault)
        return s._replace(bridged=fault, upper=p.level.missed(p.upper, s.upper))
    goal, begun, following = s.goal, s.begun, s.path
    assert goal is not None  # a sound reading makes one
    before = goal
    if s.later is not None and time >= s.later[1]:
        s = s._replace(later=None, path=s.later[0], begun=s.later[1])
        following, begun = s.path, s.begun
    if following is not None:
        begun = time if begun is None else begun
        if time >= begun:
            goal = path.goal_of(following, time - begun)
        if time >= begun + following.end:
            following = None
    command, after, terms = p.level.step(p.upper, s.upper, goal, reading)
    if not math.isfinite(command):
        return stopped(s, f"the upper level's command is {command}")
    if 0.0 < p.error_limit < abs(terms.error):
        return stopped(
            s, f"the position is {abs(terms.error):.4g} m off its goal, error_limit is {p.error_limit:g} m"
        )
    return s._replace(
        upper=after,
        path=following,
        begun=begun,
        goal=goal,
        jerk=(goal.acceleration - before.acceleration) / (periods * p.period),
        command=command,
        terms=terms,
        bridged="",
    )


def estimates(p: Params, s: State) -> dict[str, str]:
    """What the upper level has learnt of the axis, in words by name with unit."""
    return {name: f"{value:.4g}" for name, value in p.level.estimates(s.upper).items()}


def silent(s: State, why: str) -> State:
    """State when no reading is answered any more, and ``why``; before the first one nothing is stopped."""
    return s if s.goal is None else stopped(s, why)


def spool_motion(p: Params, s: State) -> axis_pid.SpoolReference:
    """Motion of the spool that is commanded: at rest where it is held or stopped."""
    if s.stopped or s.goal is None:
        return axis_pid.SpoolReference(s.command, 0.0, 0.0)
    moved: axis_pid.SpoolReference = p.level.motion(p.upper, s.upper, s.goal, s.jerk, s.terms)
    return moved
