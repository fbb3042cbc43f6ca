# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the spool command of an axis: velocity feedforward, PID on the position, overlap compensation.

With ki = kd = 0 it is the controller of industry's axes: proportional with velocity feedforward. The sum of
feedforward and PID is a velocity; it becomes a spool position by the valve's velocity gain in that
direction, and the overlap of the spool is jumped, on a straight line through the middle, so that the jump
has a finite slope.
"""

from typing import NamedTuple

from valve_control.axis.course import Goal
from valve_control.axis.machine import Reading
from valve_control.control.laws import velocity
from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Parameter, Table, Values, number


class Params(NamedTuple):
    """Gains of the upper level at one sample period."""

    kp: float  # 1/s
    ki: float  # 1/s²
    kd: float  # -
    feedforward: float  # -
    acceleration_feedforward: float  # s
    gain_out: float  # m/s/V  velocity per spool position beyond the overlap, outwards
    gain_in: float  # m/s/V
    overlap: float  # V
    overlap_zone: float  # V  spool command below which the jump is not whole
    limit: float  # V  of the command
    period: float  # s
    derivative: velocity.Params


class State(NamedTuple):
    """Integrator and derivative filter."""

    integral: float  # m/s
    error: velocity.State  # m


class Terms(NamedTuple):
    """What the upper level computed at this sample."""

    error: float  # m  goal less reading
    velocity: float  # m/s  that is asked of the valve
    spool: float  # V


AT_REST = Terms(0.0, 0.0, 0.0)
NEEDS_PRESSURES = False


def initial(p: Params) -> State:
    """At rest at its goal."""
    return State(0.0, velocity.State(0.0, 0.0))


def estimates(s: State) -> dict[str, float]:
    """What has been learnt of the axis, by name with unit: nothing."""
    return {}


def step(p: Params, s: State, goal: Goal, reading: Reading) -> tuple[float, State, Terms]:
    """Compute one sample; returns the spool command [V], the next state and the terms.

    The integrator rests while the command is at its limit and the error would drive it deeper.
    """
    error = goal.position - reading.position
    filtered = velocity.step(p.derivative, s.error, error)
    integral = s.integral + p.ki * error * p.period
    feedforward = p.feedforward * goal.velocity + p.acceleration_feedforward * goal.acceleration
    wanted = feedforward + p.kp * error + integral + p.kd * filtered.velocity
    beyond = wanted / (p.gain_out if wanted > 0.0 else p.gain_in)
    spool = beyond + p.overlap * saturate(beyond / p.overlap_zone, 1.0)
    command = saturate(spool, p.limit)
    if (spool > command and error > 0.0) or (spool < command and error < 0.0):
        integral = s.integral
    return command, State(integral, filtered), Terms(error, wanted, command)


def missed(p: Params, s: State) -> State:
    """State after a sample without a reading: the error goes on at its rate."""
    error = velocity.State(s.error.measurement + p.period * s.error.velocity, s.error.velocity)
    return State(s.integral, error)


class SpoolReference(NamedTuple):
    """Motion of the spool that is wanted, of one sample."""

    position: float  # V
    velocity: float  # V/s
    acceleration: float  # V/s²


def motion(p: Params, s: State, goal: Goal, jerk: float, terms: Terms) -> SpoolReference:
    """Spool command with its derivatives; ``s`` and ``terms`` are those after the step with ``goal``.

    The velocity is that of feedforward, proportional and integral part, the acceleration that of the course's
    ``jerk`` [m/s³] alone: readings have no second derivative worth the name.
    """
    gain = p.gain_out if terms.velocity > 0.0 else p.gain_in
    beyond = terms.velocity / gain
    slope = 1.0 / gain
    if abs(beyond) < p.overlap_zone:
        slope *= 1.0 + p.overlap / p.overlap_zone
    if abs(terms.spool) >= p.limit:
        slope = 0.0
    rate = p.feedforward * goal.acceleration + p.acceleration_feedforward * jerk
    rate += p.kp * s.error.velocity + p.ki * terms.error
    return SpoolReference(terms.spool, slope * rate, slope * p.feedforward * jerk)


PARAMETERS: Table = (
    Parameter("kp", 10.0, "1/s", "proportional gain: velocity per position error", 0.0, 1e4),
    Parameter("ki", 0.0, "1/s²", "integral gain", 0.0, 1e6),
    Parameter("kd", 0.0, "-", "derivative gain: velocity per rate of the position error", 0.0, 100.0),
    Parameter("velocity_feedforward", 1.0, "-", "share of the course's velocity in the command", 0.0, 10.0),
    Parameter(
        "acceleration_feedforward", 0.0, "s", "lead: velocity per acceleration of the course", -10.0, 10.0
    ),
    Parameter(
        "gain_out", 0.0, "m/s/V", "velocity of extension per V beyond overlap; 0: from the machine", 0.0, 1e3
    ),
    Parameter(
        "gain_in", 0.0, "m/s/V", "velocity of retraction per V beyond overlap; 0: from the machine", 0.0, 1e3
    ),
    Parameter("overlap", 0.3, "V", "overlap of the spool that is compensated", 0.0, 100.0),
    Parameter("overlap_zone", 0.05, "V", "command beyond the overlap of whole compensation", 1e-6, 100.0),
    Parameter("spool_limit", 10.0, "V", "limit of the spool command", 0.01, 100.0),
    Parameter("derivative_cutoff", 50.0, "Hz", "cut-off of the low-pass of the derivative", 1.0, 1e5),
)


def build(values: Values, gain_out: float, gain_in: float) -> Params:
    """Params from checked values; ``gain_out`` and ``gain_in`` [m/s/V] for those that are left at 0."""
    period = number(values, "sample_period")
    return Params(
        **{name: number(values, name) for name in ("kp", "ki", "kd", "overlap", "overlap_zone")},
        feedforward=number(values, "velocity_feedforward"),
        acceleration_feedforward=number(values, "acceleration_feedforward"),
        gain_out=number(values, "gain_out") or gain_out,
        gain_in=number(values, "gain_in") or gain_in,
        limit=number(values, "spool_limit"),
        period=period,
        derivative=velocity.design(number(values, "derivative_cutoff"), period),
    )
