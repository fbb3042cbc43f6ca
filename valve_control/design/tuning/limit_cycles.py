# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds loops that do not come to rest: limit cycles after steps and motions, on simulated valves.

Margins are those of small motions around 0 V with the first estimates. A law that adapts is another one after
a step: its estimates have moved, some to their bounds, and at a position x every estimate that multiplies x
integrates the error like that of a constant disturbance, with x² times its rate. And friction sustains
swings. All this shows in a run alone.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.analysis.limit_cycle import ends_at_rest
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import registry
from valve_control.control.simulation import batch
from valve_control.design.tuning import trial
from valve_control.design.tuning.trial import GainSet, Problem, Threads, TuningLimits, TuningMotion
from valve_control.parameter import Values, number, updated

Valves = npt.NDArray[np.int64]  # numbers of valves
STEPS_NAME = "steps"
STEPS = (0.3, -1.0)  # V  with which a loop is tried; each is held for HELD
HELD = 1.0  # s
LASTING = 5.0  # s  after which what swings still is a limit cycle, and does not ring down
RESTING = 0.5  # s  at the end of each step, in which the loop has to rest
REST = 0.05  # V  amplitude about a straight line from which on it does not: noise stays far below
TURNS = 4  # from half of that on one side of the line to the other; what creeps has two, whatever rides on it
OWN = 2.0  # times a valve's own swing at a constant voltage, up to which that of the loop is the valve's
LEAST = 0.01  # V  amplitude of a valve's own swing, at least
SETTLED = 2.0  # s  after which a valve at a constant voltage rests, unless it swings by itself
CHUNK = 512  # valves whose signals are kept at a time
STRESS = 0.5  # of the margins that are asked for, by which the valves of the search are harder than its box
FARTHER = 1.25  # times the reach of the motions, to which the search steps
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def steps(
    period: float, motions: Sequence[TuningMotion] = (), farther: float = 1.0, held: float = HELD
) -> TuningMotion:
    """Steps of STEPS, and one ``farther`` times as far as the ``motions`` go; each is ``held`` [s]."""
    n = round(held / period)
    reach = farther * max((float(np.max(np.abs(motion.wanted))) for motion in motions), default=0.0)
    heights = (*STEPS, reach) if reach > max(map(abs, STEPS)) else STEPS
    rest = np.zeros(round(HELD / period) // 10)
    return TuningMotion(STEPS_NAME, np.concatenate([rest, *(np.full(n, h) for h in heights)]))


def stressed(plants: Sequence[Any], limits: TuningLimits) -> list[Any]:
    """``plants``, each with STRESS of the margins used up: more gain, less gain or more dead time, in turn.

    Friction is a part of theirs, another one for each: what swings with much of it need not with little.
    """
    factor = 10.0 ** (STRESS * limits.gain_db / 20.0)
    made = []
    for i, plant in enumerate(plants):
        later = STRESS * limits.delay_s / plant.period if i % 3 == 2 else 0.0
        gain = (factor, 1.0 / factor, 1.0)[i % 3]
        made.append(registry.plant_of(plant).varied(plant, gain, later, 1.0 - (i * GOLDEN) % 1.0))
    return made


def restless_shares(
    law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None
) -> list[float]:
    """Share of the ``stressed`` box of ``problem`` on which each of ``several`` does not rest after steps.

    It has HELD for it. The last of the steps goes FARTHER than the motions. What counts: see ``after_all``.
    """
    hard = stressed(problem.box, problem.limits)
    tried = [steps(problem.period, problem.motions, FARTHER)]
    found = _restless(law, problem, several, hard, tried, HELD, threads)
    return [len(restless) / len(hard) for restless in found]


def after_all(
    law: Law,
    problem: Problem,
    gains: GainSet,
    plants: Sequence[Any],
    threads: Threads = None,
    held: float = HELD,
) -> Valves:
    """Numbers of the ``plants`` on which the loop does not rest after one of the ``steps`` or motions.

    Each is ``held`` [s]; with LASTING only limit cycles are left. In the last RESTING of it the spool has to
    rest, and the voltage must not show what a controller node reports as an oscillation. A run that does not
    stay finite counts. A spool that swings at a constant voltage, and in the loop less than OWN times as
    much, does not, unless ``problem`` is strict and the node would report it. While a command moves, friction
    answers it with harmonics, which are no limit cycle.
    """
    period, tried = problem.period, [steps(problem.period, problem.motions, held=held)]
    for motion in problem.motions:
        end = np.full(round(held / period), motion.wanted[-1])
        tried.append(motion._replace(wanted=np.concatenate([motion.wanted, end])))
    return _restless(law, problem, [gains], plants, tried, held, threads)[0]


def _restless(
    law: Law,
    problem: Problem,
    several: Sequence[GainSet],
    plants: Sequence[Any],
    tried: Sequence[TuningMotion],
    held: float,
    threads: Threads,
) -> list[Valves]:
    """Numbers of the ``plants``, for each of ``several``, on which the loop swings after being ``held`` [s].

    Loops of all of them are simulated together, CHUNK at a time. Of each loop the largest swing counts.
    """
    if not plants:
        return [np.empty(0, dtype=np.int64) for _ in several]
    loops, n, period = trial.Loops(law, problem, several, plants, problem.seed), len(plants), problem.period
    hold, window, limit = (
        round(held / period),
        round(HELD / period),
        number(problem.values, "oscillation_limit"),
    )
    amplitude, voltage = np.full(loops.count, -1.0), np.zeros(loops.count)  # V  -1.0: it rests
    reported = np.zeros(loops.count, dtype=bool)  # by a controller node, where that counts
    for motion in tried:
        stepping = motion.name == STEPS_NAME  # of which nobody sends the derivatives
        led = loops.commands(motion.wanted, problem._replace(preview=False) if stepping else None)
        samples = led.shape[1]
        for first in range(0, loops.count, CHUNK):
            some = slice(first, min(first + CHUNK, loops.count))
            traces = np.empty((some.stop - first, samples, 3))
            loops.run(motion.wanted, led, threads, some, traces)
            for end in range(samples, hold, -hold) if stepping else [samples]:
                last = traces[:, end - window : end]
                swinging, noisy = restless(last, period, limit)
                at = first + np.flatnonzero(swinging)
                rest = last[swinging, -round(RESTING / period) :]
                swing = np.nan_to_num(_amplitude(_about_a_line(rest[:, :, 0])), nan=math.inf)
                larger = swing > amplitude[at]
                amplitude[at[larger]] = swing[larger]
                voltage[at[larger]] = np.mean(rest[larger, :, 2], axis=1)
                reported[at] |= noisy[swinging] & problem.strict
    own = np.flatnonzero(amplitude >= 0.0)
    counted = reported[own] | _by_feedback(
        problem.values,
        [plants[i] for i in (own % n).tolist()],
        own % n,
        voltage[own],
        amplitude[own],
        threads,
    )
    numbers = own[counted]
    return [numbers[numbers // n == j] % n for j in range(len(several))]


def restless(
    traces: Floats, period: float, least: float
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Which of N loops still swing at the end of ``traces`` (N×n×3) at one command, or are not finite.

    Beside that, of which a controller node would still report an oscillation of the voltage, which are among
    them. ``least`` [V]: its amplitude from which on it counts; 0.0: none does.
    """
    finite = np.all(np.isfinite(traces), axis=(1, 2))
    swing = _about_a_line(np.where(finite[:, None], traces[:, -round(RESTING / period) :, 0], 0.0))
    large = np.ptp(swing, axis=1) > 2.0 * REST
    turning = [bool(one) and _turns(row, 0.5 * REST) >= TURNS for one, row in zip(large, swing, strict=True)]
    reported = np.asarray(ends_at_rest(traces[:, :, 2], period, least) > HELD - RESTING, dtype=bool)
    return np.asarray(~finite | np.array(turning, dtype=bool) | reported), reported


def _amplitude(swing: Floats) -> Floats:
    """Amplitude of the sine that is as large, root mean square, as a ``swing`` about 0 V (N×n)."""
    return np.asarray(math.sqrt(2.0) * np.std(swing, axis=-1), dtype=float)


def _about_a_line(position: Floats) -> Floats:
    times = np.linspace(-1.0, 1.0, position.shape[-1])
    swing = position - np.mean(position, axis=-1, keepdims=True)
    about: Floats = swing - (swing @ times / (times @ times))[..., None] * times
    return about


def _turns(swing: Floats, beyond: float) -> int:
    """How often a ``swing`` about 0 V (n) goes from ``beyond`` [V] on one side to that on the other."""
    return int(np.count_nonzero(np.diff(np.signbit(swing[np.abs(swing) > beyond]))))


def _by_feedback(
    values: Values, plants: Sequence[Any], seeds: Valves, voltage: Floats, amplitude: Floats, threads: Threads
) -> npt.NDArray[np.bool_]:
    """Whether swings [V] of loops on ``plants`` are not the valve's own at the mean ``voltage`` [V]."""
    bare, period = LAWS["open_loop"], number(values, "sample_period")
    straight = {"open_loop.static_gain": 1.0, "linearisation.enabled": False}
    params = bare.build(updated(CONTROLLER, values, straight))
    counted = np.ones(len(plants), dtype=bool)
    for first in range(0, len(plants), CHUNK):
        some = slice(first, first + CHUNK)
        constant = np.nan_to_num(voltage[some], posinf=0.0, neginf=0.0)
        command = np.repeat(constant[:, None], round(SETTLED / period), axis=1)
        traces = np.empty((*command.shape, 3))
        rows = batch.records(plants[some])
        batch.simulate(batch.Batch(bare.name, params, rows, seeds[some], command), threads, traces)
        own = _about_a_line(traces[:, -round(RESTING / period) :, 0])
        rests = np.array([_turns(row, 0.5 * LEAST) < TURNS for row in own]) | ~(_amplitude(own) > LEAST)
        counted[some] = rests | (amplitude[some] >= OWN * _amplitude(own))
    return counted
