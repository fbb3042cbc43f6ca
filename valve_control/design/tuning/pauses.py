# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tries what a pause of the command does to the reference: whether it comes back to that without one.

A fast motion has two answers of the reshaping (8) to (11) once the acceleration (6) is at its limit: the
small one, which follows it, and one of several times its size, of which the acceleration is at one limit or
at the other. A step of the command, as after a pause of the upper level, can lead from the first to the
second, which then lasts as long as the motion: a jump resonance. The faster the reshaping the shorter the
pause that does it, for what damps (8) at the limit is its lag 2·xi_n/omega_n, less the delay of a sample.
"""

import math
from collections.abc import Sequence

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.compiling import compile_function
from valve_control.control.laws import command_lead, reshaping
from valve_control.control.laws.law import Law
from valve_control.design.tuning import trial
from valve_control.design.tuning.trial import GainSet, Problem, Threads
from valve_control.parameter import number

EVERY = 0.41  # s  from one pause to the next
OFFSETS = 8  # places of the first one
SEEN = 0.1  # s  before the next pause, in which the reference has to be back
BACK = 0.1  # of the reach of the motion, within which it is
STEP = 0.002  # s  from one length to the next
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def unborne(law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None) -> list[float]:
    """The shortest pause [s] of a command with each of ``several`` gains, after which it goes wrong.

    That is, the reference does not come back. It is below the limit of ``problem``, up to which they are
    tried; inf: none.
    """
    return [_shortest(law, problem, gains) for gains in several]


def _shortest(law: Law, problem: Problem, gains: GainSet) -> float:
    """Of every STEP of length, at OFFSETS places of each of the motions.

    Infinite for what is not looked at too: a law that does not reshape, and motions that are known ahead,
    which come with their rate and acceleration.
    """
    values = trial.values_with(problem, gains)
    params = trial.built(law, values)
    if problem.preview or not law.reshapes(params):
        return math.inf
    period, limit = number(values, "sample_period"), number(values, "command_limit")
    none = command_lead.Params(0.0, 0.0, 0.0, 0.0, 0.0, limit, period)
    lead = command_lead.build(values, True) or none
    fill = compile_function(_fill, nogil=True)
    every, seen = round(EVERY / period), round(SEEN / period)

    def reference(commands: Floats, pause: int, first: int) -> Floats:
        made = np.empty_like(commands)
        fill(params.reshaping, lead, commands, pause, first, every, made)
        return made

    tried = []
    for motion in problem.motions:
        commands = np.clip(motion.wanted, -limit, limit)
        undisturbed, allowed = reference(commands, 0, 0), BACK * float(np.max(np.abs(commands)))
        for i in range(OFFSETS):
            first = round((i * GOLDEN) % 1.0 * every)
            looked_at = (np.arange(len(commands)) - first) % every >= every - seen
            tried.append((commands, first, undisturbed[looked_at], looked_at, allowed))
    most = problem.limits.pause_s
    times = [t for t in (*(STEP * (i + 1) for i in range(math.floor(most / STEP + 1e-6))), most) if t > 0.0]
    for pause in sorted({max(1, math.floor(time / period + 1e-6)) for time in times}):
        for commands, first, wanted, looked_at, allowed in tried:
            away = np.abs(reference(commands, pause, first)[looked_at] - wanted)
            if np.max(away, initial=0.0) > allowed:
                return math.nextafter(min(pause * period, most), 0.0)
    return math.inf


def _fill(
    p: reshaping.Params,
    lead: command_lead.Params,
    commands: Floats,
    pause: int,
    first: int,
    every: int,
    result: Floats,
) -> None:
    """Write the reference [V] under ``commands`` [V] into ``result``.

    They pause for so many samples from sample ``first`` on, and again after ``every`` samples.
    """
    held = commands[0]
    led, state = command_lead.initial(held), reshaping.State(held, 0.0)
    for k in range(len(commands)):
        result[k] = state.reference
        if (k - first) % every >= pause:
            held = commands[k]
        led = command_lead.step(lead, led, held)
        accel = reshaping.acceleration(p, state, command_lead.led(lead, led, held))
        state = reshaping.advance(p, state, accel)
