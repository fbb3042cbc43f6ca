# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lead of a bare command: makes up for the lag of the reshaping (8) from past commands.

A command that moves at a steady rate is followed by (8) with the lag 2·xi_n/omega_n. Under the command
x_vLd + T·dx_vLd/dt with T equal to it there is none, and a larger T makes up for the lag of the loop as well.
The rate comes from past commands: the median of the last three differences, so that neither a step nor a
command that comes a sample late or twice counts as motion; and it grows no faster than (6) allows.

Where the rate changes, an error is left that is proportional to the acceleration of the command. A part of
the lead that is proportional to it, up to the whole of that error, makes up for it
(docs/explanation/laws/reshaping.md).
"""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.compiling import compile_function
from valve_control.control.laws import reshaping
from valve_control.control.laws.projection import clip
from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Values, number


class Params(NamedTuple):
    """Lead, and the limits of what counts as motion."""

    time: float  # s    T, above 0
    share: float  # -    of the error under a steady acceleration that is made up for
    bend: float  # s²   acceleration's part of the lead, where the rate is that of this sample
    max_rate: float  # V/s  bound (7)
    max_change: float  # V/s  growth of the rate in a sample, from (6)
    limit: float  # V    of the command with its lead
    period: float  # s    ΔT


class State(NamedTuple):
    """What is known of the commands before."""

    command: float  # V    of the sample before
    last: float  # V/s  its difference to the one before, over ΔT
    older: float  # V/s  the difference before that
    rate: float  # V/s  estimate at the sample before
    accel: float  # V/s²  change of that estimate


AGE = 1.5  # periods, of the median of three differences under a steady acceleration


def build(values: Values, reshaped: bool) -> Params | None:
    """Lead from the controller's values, None for none; ``reshaped``: the law reshapes its command by (8)."""
    time = number(values, "reshaping.lead")
    if time == 0.0:
        return None
    period = number(values, "sample_period")
    share = number(values, "reshaping.lead_accel")
    return Params(
        time,
        share,
        share * (0.5 * time * time + (_bend_of_reshaping(values, period) if reshaped else 0.0)),
        number(values, "reshaping.max_rate"),
        number(values, "reshaping.max_accel") * period,
        number(values, "command_limit"),
        period,
    )


def _bend_of_reshaping(values: Values, period: float) -> float:
    """What (8), sampled by (11), lacks of a pure delay of 2·xi_n/omega_n, to second order [s²]."""
    wn, damping = reshaping.filter_of(values)
    return (1.0 - 2.0 * damping * damping) / (wn * wn) + damping * period / wn


def initial(command: float) -> State:
    """A command [V] at rest."""
    return State(command, 0.0, 0.0, 0.0, 0.0)


def step(p: Params, s: State, command: float) -> State:
    """Take in the ``command`` [V] of a sample; ``rate`` of the result is the estimate."""
    now = (command - s.command) / p.period
    rate = max(min(now, s.last), min(max(now, s.last), s.older))
    allowed = clip(rate, min(s.rate, 0.0) - p.max_change, max(s.rate, 0.0) + p.max_change)
    rate = clip(allowed, -p.max_rate, p.max_rate)
    accel = clip(rate - s.rate, -p.max_change, p.max_change) / p.period
    return State(command, now, s.last, rate, accel)


def led(p: Params, s: State, command: float) -> float:
    """``command`` [V] with its lead."""
    bend = p.bend + p.share * p.time * (AGE * p.period)
    return saturate(command + p.time * s.rate + bend * s.accel, p.limit)


def applied(p: Params | None, commands: Floats) -> Floats:
    """The ``commands`` [V], one a sample, as the law gets them."""
    if p is None or len(commands) == 0:
        return commands
    result = np.empty_like(commands)
    compile_function(fill)(p, commands, result)
    return result


def fill(p: Params, commands: Floats, result: Floats) -> None:
    """Write at least one of the ``commands`` [V] with their lead into ``result``."""
    s = initial(commands[0])
    for k in range(len(commands)):
        s = step(p, s, commands[k])
        result[k] = led(p, s, commands[k])
