# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Delivers the commands of an upper level to a simulated controller as a node gets them.

The upper level sends the wanted motion every command period; each message is early or late on its way, and
the controller takes at each sample those that have come. It holds the newest, joins them as
``command.interpolation`` says, or bridges those that are late (``command.bridge``), with the node's own
functions.
"""

import functools
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.compiling import compile_function
from valve_control.control.laws import command_lead
from valve_control.control.supervision import command_course, late_commands
from valve_control.parameter import ParameterError, Values, number, word

TOGETHER = 1e-9  # s  within which a message counts as come at the time of a sample


class Delivery(NamedTuple):
    """How the commands of an upper level come."""

    period: float  # s  from one command to the next
    jitter: float = 0.0  # s  by which each comes early or late at most
    seed: int = 1  # of that


class Received(NamedTuple):
    """Commands as the controller has them at each sample, before their lead."""

    values: Floats  # V
    rates: Floats | None  # V/s of commands that are joined; None: of those that are held


def check(values: Values, delivery: Delivery) -> None:
    """Raise ParameterError for a ``delivery`` that cannot be, at the sample period of ``values``."""
    period, most = number(values, "sample_period"), late_commands.LONGEST
    if not period <= delivery.period <= most:
        raise ParameterError(
            f"--command-period is {delivery.period:g} s; it must lie between the sample period, "
            f"{period:g} s, and {most:g} s"
        )
    if not 0.0 <= delivery.jitter <= delivery.period:
        raise ParameterError(
            f"--command-jitter is {delivery.jitter:g} s; it must lie between 0 and the period of the "
            f"commands, {delivery.period:g} s"
        )


def of_each_sample(values: Values) -> Delivery | None:
    """Delivery of one command a sample, in time, by a controller's ``values``; None: they are held."""
    if values["command.interpolation"] == "hold":
        return None
    return Delivery(number(values, "sample_period"))


def received(values: Values, wanted: Floats, delivery: Delivery) -> Received:
    """Commands at each sample for the ``wanted`` motion [V], one entry a sample; not limited yet."""
    kind, limit = word(values, "command.interpolation"), number(values, "command_limit")
    period, bridging = number(values, "sample_period"), late_commands.design(values)
    in_time = delivery.jitter == 0.0 and delivery.period == period
    if bridging is not None and not bridging.every and in_time:
        bridging = None
    return _received(wanted.tobytes(), delivery, kind, limit, period, bridging)


@functools.lru_cache(maxsize=64)
def _received(
    wanted: bytes,
    delivery: Delivery,
    kind: str,
    limit: float,
    period: float,
    bridging: late_commands.Params | None,
) -> Received:
    course = command_course.design(
        {"command.interpolation": kind, "command_limit": limit, "sample_period": period}
    )
    motion = np.clip(np.frombuffer(wanted), -limit, limit)
    n = len(motion)
    sent = np.arange(np.ceil(n * period / delivery.period)) * delivery.period
    late = np.random.default_rng(delivery.seed).uniform(-delivery.jitter, delivery.jitter, len(sent))
    late[0] = min(late[0], 0.0)
    arrivals = np.maximum.accumulate(sent + late)
    commands = np.interp(sent, np.arange(n) * period, motion)
    taken_at = np.ceil((arrivals - TOGETHER) / period).clip(0).astype(int)
    if course is None and bridging is not None:
        return Received(_bridged(bridging, taken_at, commands, delivery.period, n), None)
    if course is None:
        newest = np.searchsorted(taken_at, np.arange(n), side="right") - 1
        return Received(commands[newest], None)
    values, rates = np.empty(n), np.empty(n)
    state: command_course.State | None = None
    k = 0
    for i in range(n):
        while k < len(sent) and taken_at[k] <= i:
            interval = delivery.period if k else 0.0
            state = command_course.taken(course, state, float(commands[k]), interval, i * period)
            k += 1
        assert state is not None, "the first command comes with the first sample"
        values[i], rates[i] = command_course.value(state, i * period), command_course.rate(state, i * period)
    return Received(values, rates)


def _bridged(
    p: late_commands.Params, taken_at: npt.NDArray[np.int64], commands: Floats, interval: float, n: int
) -> Floats:
    """The ``commands`` [V], taken at these samples, at each of ``n`` samples; late ones are bridged."""
    values = np.empty(n)
    state: late_commands.State | None = None
    k = 0
    for i in range(n):
        now = i * p.period
        while k < len(commands) and taken_at[k] <= i:
            state = late_commands.taken(p, state, float(commands[k]), interval if k else 0.0, now)
            k += 1
        assert state is not None, "the first command comes with the first sample"
        values[i] = late_commands.value(p, state, now)
    return values


def given(
    lead: command_lead.Params | None, values: Values, command: Floats, delivered: Delivery | None
) -> Floats:
    """Commands [V] as a law gets them at each sample, with the ``lead``, of those ``delivered``."""
    if delivered is None:
        return command_lead.applied(lead, command)
    return led(lead, received(values, command, delivered))


def led(lead: command_lead.Params | None, got: Received) -> Floats:
    """``got`` with the ``lead`` as a node has it, one entry a sample [V]."""
    if lead is None:
        return got.values
    made = np.empty_like(got.values)
    if got.rates is None:
        compile_function(command_lead.fill)(lead, got.values, made)
    else:
        compile_function(_fill)(lead, got.values, got.rates, made)
    return made


def _fill(lead: command_lead.Params, values: Floats, rates: Floats, result: Floats) -> None:
    """Write the ``values`` [V] of commands whose ``rates`` [V/s] are known with their lead."""
    state = command_lead.initial(values[0])
    for k in range(len(values)):
        state = command_lead.known(lead, state, values[k], rates[k], 0.0)
        result[k] = command_lead.led(lead, state, values[k])
