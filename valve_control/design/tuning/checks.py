# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tries gains in runs of their own for what no margin shows: pauses of the command, rest, overshoot.

Margins are those of small motions around 0 V with the first estimates (docs/explanation/tuning.md). After a
pause a fast motion can stay on the large answer of the reshaping, a jump resonance
(docs/explanation/laws/reshaping.md).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.analysis import steps as answers_of_steps
from valve_control.control.analysis.limit_cycle import surveyed
from valve_control.control.compiling import compile_function
from valve_control.control.laws import command_lead, reshaping
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import registry
from valve_control.control.simulation import batch
from valve_control.design.tuning import trial
from valve_control.design.tuning.trial import GainSet, Problem, Threads, TuningLimits, TuningMotion
from valve_control.parameter import Values, number, updated

Valves = npt.NDArray[np.int64]  # numbers of valves
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)

EVERY = 0.41  # s  from one pause to the next
OFFSETS = 8  # places of the first one
SEEN = 0.1  # s  before the next pause, in which the reference has to be back
BACK = 0.1  # of the reach of the motion, within which it is
LONGER = 0.002  # s  from one length of a pause to the next

STEPS_NAME = "steps"
STEPS = (0.3, -1.0)  # V  with which a loop is tried; each is held for HELD
HELD = 1.0  # s  of those, and of the steps that are judged by their overshoot
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

HEIGHTS = (-0.4, 0.0, 0.4, 0.0, 1.0, 0.4)  # of the reach of the motions
SHORT = 0.25  # s  that each is held in a search
LEARNT = 1.0  # s  of the motion before


def unborne(law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None) -> list[float]:
    """The shortest pause [s] of a command with each of ``several`` gains, after which it goes wrong.

    That is, the reference does not come back. Pauses are tried up to the limit of ``problem``, every LONGER
    at OFFSETS places of each motion; inf: none goes wrong. Infinite for what is not looked at too: a law that
    does not reshape, and motions that are known ahead, which come with their rate and acceleration.
    """
    return [_shortest_pause(law, problem, gains) for gains in several]


def _shortest_pause(law: Law, problem: Problem, gains: GainSet) -> float:
    values = trial.values_with(problem, gains)
    params = trial.built(law, values)
    if problem.preview or not law.reshapes(params):
        return math.inf
    period, most, limit = problem.period, problem.limits.pause_s, number(values, "command_limit")
    lead, follow = command_lead.build(values, True), compile_function(_follow, nogil=True)
    every, seen = round(EVERY / period), round(SEEN / period)

    def reference(commands: Floats, pause: int, first: int) -> Floats:
        """Reference [V] under ``commands`` [V] that pause for so many samples, first at ``first``."""
        at, result = np.arange(len(commands)), np.empty_like(commands)
        last_sent = np.maximum.accumulate(np.where((at - first) % every >= pause, at, 0))
        follow(params.reshaping, command_lead.applied(lead, commands[last_sent]), result)
        return result

    tried = []
    for motion in problem.motions:
        commands = np.clip(motion.wanted, -limit, limit)
        undisturbed, allowed = reference(commands, 0, 0), BACK * float(np.max(np.abs(commands)))
        for i in range(OFFSETS):
            first = round((i * GOLDEN) % 1.0 * every)
            looked_at = (np.arange(len(commands)) - first) % every >= every - seen
            tried.append((commands, first, undisturbed[looked_at], looked_at, allowed))
    times = [*(LONGER * (i + 1) for i in range(math.floor(most / LONGER + 1e-6))), most] if most > 0.0 else []
    for pause in sorted({max(1, math.floor(time / period + 1e-6)) for time in times}):
        for commands, first, wanted, looked_at, allowed in tried:
            away = np.abs(reference(commands, pause, first)[looked_at] - wanted)
            if np.max(away, initial=0.0) > allowed:
                return math.nextafter(min(pause * period, most), 0.0)
    return math.inf


def _follow(p: reshaping.Params, commands: Floats, result: Floats) -> None:
    """Write the reference [V] under ``commands`` [V], from rest, into ``result``."""
    state = reshaping.State(commands[0], 0.0)
    for k in range(len(commands)):
        result[k] = state.reference
        state = reshaping.advance(p, state, reshaping.acceleration(p, state, commands[k]))


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
    harder = []
    for i, plant in enumerate(plants):
        later = STRESS * limits.delay_s / plant.period if i % 3 == 2 else 0.0
        gain = (factor, 1.0 / factor, 1.0)[i % 3]
        harder.append(registry.plant_of(plant).varied(plant, gain, later, 1.0 - (i * GOLDEN) % 1.0))
    return harder


def restless_shares(
    law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None
) -> list[float]:
    """Share of the ``stressed`` box of ``problem`` on which each of ``several`` does not rest after steps.

    It has HELD for it. The last of the steps goes FARTHER than the motions. What counts: see ``after_all``.
    """
    hard = stressed(problem.box, problem.limits)
    tried = [steps(problem.period, problem.motions, FARTHER)]
    return [len(found) / len(hard) for found in _restless(law, problem, several, hard, tried, HELD, threads)]


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
    hold, window = round(held / period), round(HELD / period)
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
                swinging, noisy = restless(last, period, number(problem.values, "oscillation_limit"))
                at = first + np.flatnonzero(swinging)
                rest = last[swinging, -round(RESTING / period) :]
                swing = np.nan_to_num(_amplitude(_about_a_line(rest[:, :, 0])), nan=math.inf)
                larger = swing > amplitude[at]
                amplitude[at[larger]] = swing[larger]
                voltage[at[larger]] = np.mean(rest[larger, :, 2], axis=1)
                reported[at] |= noisy[swinging] & problem.strict
    own = np.flatnonzero(amplitude >= 0.0)
    swingers = [plants[i] for i in (own % n).tolist()]
    by_feedback = _by_feedback(problem.values, swingers, own % n, voltage[own], amplitude[own], threads)
    numbers = own[reported[own] | by_feedback]
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
    cycles = surveyed(traces[:, :, 2], np.zeros(traces.shape[1]), period, least)
    reported = np.asarray(cycles[:, 3] > HELD - RESTING, dtype=bool)
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


def overshoots(
    law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None
) -> list[float]:
    """Overshoot [-] with each of ``several`` in steps that are held for SHORT: ``typical``."""
    return [typical(rows[0]) for rows in answers(law, problem, several, threads, SHORT)]


def typical(rows: Floats) -> float:
    """The worst of S steps of what N valves make of them (S×N), medians of the valves."""
    return float(np.max(np.median(rows, axis=1)))


def answers(
    law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None, held: float = HELD
) -> list[Floats]:
    """Overshoot [-] and settling time [s] (2×S×N) of N valves in S steps, with each of ``several`` gains.

    Infinite where a run does not stay finite, or does not settle while a step is ``held`` [s]. The valves
    have no noise. The steps reach as far as the motions. Before them are the beginning of the one that goes
    farthest, and the same steps, which are not judged.
    """
    period, n, short = problem.period, round(held / problem.period), round(SHORT / problem.period)
    farthest = max(problem.motions, key=lambda motion: float(np.max(np.abs(motion.wanted)))).wanted
    begins = int(np.argmax(farthest != farthest[0]))
    heights = float(np.max(np.abs(farthest))) * np.array(HEIGHTS)
    before = [np.zeros(short), farthest[begins : begins + round(LEARNT / period)], np.zeros(short)]
    before += [np.full(short, height) for height in (*heights, 0.0)]
    motion = np.concatenate([*before, *(np.full(n, height) for height in heights)])
    first = sum(map(len, before))
    quiet = [registry.plant_of(p).quiet(p) for p in problem.plants]
    loops = trial.Loops(law, problem, several, quiet, 0)
    led = loops.commands(motion, problem._replace(preview=False, delivery=None))
    traces = np.empty((loops.count, len(motion), 3))
    loops.run(motion, led, threads, traces=traces)
    with np.errstate(invalid="ignore"):
        found = answers_of_steps.answers(motion[first - 1 :], traces[:, first - 1 :, 0], period)
    rows = np.nan_to_num(np.array(found).swapaxes(0, 1), nan=math.inf, posinf=math.inf)
    return np.split(rows, len(several), axis=2)
