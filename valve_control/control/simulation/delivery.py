# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Delivers the commands of an upper level to a simulated controller as a node gets them.

The upper level sends the wanted motion every command period of its own clock, with the time; each message
takes some time on its way. The controller takes at each sample those that have come, and follows the motion
with the node's own functions (command_course.py).
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.compiling import compile_function
from valve_control.control.laws import command_lead, reshaping
from valve_control.control.laws.law import Law
from valve_control.control.supervision import binding, clock, command_course, trajectory
from valve_control.parameter import ParameterError, Values, number

TOGETHER = 1e-9  # s  within which a message counts as come at the time of a sample
FASTEST = 0.01  # s/s  of the sender's clock beside that of the samples


class Delivery(NamedTuple):
    """How the commands of an upper level come."""

    period: float  # s  from one command to the next
    jitter: float = 0.0  # s  on its way a message is late by up to twice this
    seed: int = 1  # of that
    drift: float = 0.0  # s/s  of the sender's clock beside that of the samples
    late: float = 0.0  # share of the messages that are late by ``lateness`` besides
    lateness: float = 0.003  # s
    pause: float = 0.0  # s  in which the upper level sends nothing, five times a second


def check(values: Values, delivery: Delivery) -> None:
    """Raise ParameterError for a ``delivery`` that cannot be, at the sample period of ``values``."""
    period = number(values, "sample_period")
    for name, value, low, high, unit in (
        ("period", delivery.period, period, command_course.LONGEST, "s"),
        ("jitter", delivery.jitter, 0.0, delivery.period, "s"),
        ("drift", 1e6 * delivery.drift, -1e6 * FASTEST, 1e6 * FASTEST, "ppm"),
    ):
        if not low <= value <= high:
            raise ParameterError(
                f"--command-{name} is {value:g} {unit}; it must lie between {low:g} and {high:g} {unit}"
            )


def received(values: Values, wanted: Floats, delivery: Delivery | None) -> Floats:
    """Commands [V] at each sample for the ``wanted`` motion [V], one entry a sample; None: in time."""
    p = command_course.design(values)
    delivery = Delivery(p.period) if delivery is None else delivery
    if delivery == Delivery(p.period, seed=delivery.seed) and p.lag == 0.0:
        return wanted
    return _received(wanted.tobytes(), delivery, p)


def messages(wanted: Floats, delivery: Delivery, period: float) -> tuple[Floats, Floats, Floats]:
    """Commands [V], their stamps [s] by the sender's clock, and the times [s] at which they come.

    ``wanted`` [V]: one entry for each sample ``period`` [s]; between them Akima's spline, without overshoot.
    """
    n, random = len(wanted), np.random.default_rng(delivery.seed)
    step = delivery.period * (1.0 + delivery.drift)
    sent = np.arange(math.ceil(n * period / step - TOGETHER)) * step
    late = random.uniform(0.0, 2.0 * delivery.jitter, len(sent))
    late += delivery.lateness * (random.uniform(size=len(sent)) < delivery.late)
    if delivery.pause > 0.0:
        begins = np.arange(0.5, n * period, 0.2) + random.uniform(0.0, 0.1)
        paused = (sent[:, None] > begins) & (sent[:, None] < begins + delivery.pause)
        sent, late = sent[~paused.any(axis=1)], late[~paused.any(axis=1)]
    late[0] = 0.0
    at = np.minimum(sent / period, n - 1.0)
    whole = np.abs(at - np.round(at)) * period < TOGETHER
    commands = np.asarray(wanted[np.round(at).astype(int)], dtype=np.float64)
    if not whole.all():
        from scipy.interpolate import Akima1DInterpolator  # takes a while

        commands[~whole] = Akima1DInterpolator(np.arange(n), wanted)(at[~whole])
    came: Floats = np.maximum.accumulate(sent + late)
    return commands, np.asarray(sent / (1.0 + delivery.drift), dtype=np.float64), came


@functools.lru_cache(maxsize=64)
def _received(wanted: bytes, delivery: Delivery, p: command_course.Params) -> Floats:
    motion = np.clip(np.frombuffer(wanted), -p.limit, p.limit)
    return followed(p, *messages(motion, delivery, p.period), len(motion))


def followed(p: command_course.Params, commands: Floats, stamps: Floats, came: Floats, n: int) -> Floats:
    """Command [V] at each of ``n`` samples, of ``commands`` [V] with ``stamps`` [s] that ``came`` [s]."""
    result = np.empty(n)
    taken_at: npt.NDArray[np.int64] = np.ceil((came - TOGETHER) / p.period).clip(0).astype(np.int64)
    rest = command_course.begun(p, float(commands[0]), float(stamps[0]), float(stamps[0]))
    compile_function(_fill)(p, rest, clock.NOTHING, commands, stamps, came, taken_at, result)
    return result


def _fill(
    p: command_course.Params,
    course: command_course.State,
    sender: clock.State,
    commands: Floats,
    stamps: Floats,
    came: Floats,
    taken_at: Any,
    result: Floats,
) -> None:
    """Write the command [V] of each sample into ``result``; the clock of the samples is that of ``came``."""
    k = 0
    for i in range(len(result)):
        while k < len(commands) and taken_at[k] <= i:
            sender = clock.step(sender, came[k], came[k] - stamps[k])
            sent = stamps[k] + clock.offset(sender)
            course = command_course.taken(p, course, commands[k], sent, stamps[k])
            k += 1
        result[i] = command_course.value(p, course, i * p.period)


def unreshaped(p: reshaping.Params, wanted: Floats) -> Floats:
    """Command [V] whose reshaped reference (8)-(11) is ``wanted``, which has two samples more.

    Where a filter behind (8), or a dead time of the actuator, asks for more, ``wanted`` goes on straight.
    """
    if p.dead_time > 0.0:
        more = math.ceil(p.dead_time / p.period)
        longer = np.concatenate([wanted, wanted[-1] + (wanted[-1] - wanted[-2]) * np.arange(1, more + 1)])
        steps = np.arange(len(wanted)) + p.dead_time / p.period
        wanted = np.interp(steps, np.arange(len(longer)), longer)
    if p.smoothing > 0.0:
        rate = np.diff(wanted) / p.period
        wanted = wanted + np.append(rate, rate[-1]) / p.smoothing
    p = p._replace(dead_time=0.0, smoothing=0.0)
    rate = np.diff(wanted) / p.period
    accel = np.diff(rate) / p.period
    if p.braking > 0.0:
        rows = zip(wanted[:-2].tolist(), rate[:-1].tolist(), accel.tolist(), strict=True)
        return np.array([reshaping.command_of(p, x, v - 0.5 * p.period * a, a) for x, v, a in rows])
    lag = 2.0 * p.damping / p.natural_frequency
    return np.asarray(wanted[:-2] + lag * rate[:-1] + accel / p.natural_frequency**2)


def of_points(law: Law, params: Any, position: Floats, rate: Floats, accel: Floats) -> Floats:
    """Command [V] that lets ``law`` follow points of a trajectory [V, V/s, V/s²], as on spool_trajectory."""
    follow = binding.places_of(law, 0.0)["law_commanded"]
    points = zip(position.tolist(), rate.tolist(), accel.tolist(), strict=True)
    return np.array([follow(params, trajectory.Motion(*point)) for point in points])


def led(
    lead: command_lead.Params | None, values: Values, command: Floats, delivery: Delivery | None
) -> Floats:
    """Commands [V] as a law gets them at each sample, with the ``lead``; ``delivery``: how they come."""
    return command_lead.applied(lead, received(values, command, delivery))
