# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tries how valves answer steps of the command: overshoot and settling time of a set of gains.

The valves are those of a problem, without noise of the LVDT: it is the law that is judged. First the spool
follows a motion of the problem. A law that adapts is another one before it has moved: a small step in one
direction does not tell the offset, the friction that holds the spool and the gain from each other, and a part
that counts as friction acts with the wrong sign when the spool turns back. The steps go out, back to 0 and
part of the way back, since estimates that have moved at a position answer the way back otherwise than the way
out.
"""

import math
from collections.abc import Sequence

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import steps
from valve_control.control.laws import linearisation
from valve_control.control.laws.law import Law
from valve_control.control.plant import registry
from valve_control.control.simulation import batch
from valve_control.design.tuning import trial
from valve_control.design.tuning.trial import GainSet, Problem, TuningMotion, Workers
from valve_control.parameter import number

HEIGHTS = (-0.4, 0.0, 0.4, 0.0, 1.0, 0.4)  # of the reach of the motions
HELD, SHORT = 1.0, 0.3  # s  that each is held, in verification and in a search
LEARNT = 2.0  # s  of the motion before


def answers(law: Law, problem: Problem, several: Sequence[GainSet], workers: Workers = None) -> list[Floats]:
    """Overshoot [-] and settling time [s] (2×N) with each of ``several``: of each valve in its worst step.

    Infinite where a run does not stay finite, or does not settle within HELD.
    """
    return [rows[:, 0] for rows in trial.shared(_held, law, problem, several, workers)]


def medians(law: Law, problem: Problem, several: Sequence[GainSet], workers: Workers = None) -> list[float]:
    """Overshoot [-] with each of ``several``, median of the valves' worst steps, each held for SHORT."""
    found = trial.shared(_short, law, problem, several, workers)
    return [float(np.median(rows[0, 0])) for rows in found]


def tried(period: float, motions: Sequence[TuningMotion], held: float = HELD) -> tuple[Floats, int]:
    """Commands [V], one entry a sample ``period`` [s], and the number of the first that is judged.

    The steps reach as far as the ``motions``; before them is the beginning of the one that goes farthest.
    """
    n = round(held / period)
    farthest = max(motions, key=lambda motion: float(np.max(np.abs(motion.wanted)))).wanted
    begins = int(np.argmax(farthest != farthest[0]))
    learnt = farthest[begins : begins + round(LEARNT / period)]
    reach = float(np.max(np.abs(farthest)))
    parts = [np.zeros(n // 10), learnt, np.zeros(n), *(np.full(n, height * reach) for height in HEIGHTS)]
    return np.concatenate(parts), sum(map(len, parts[:3]))


def _held(law: Law, problem: Problem, several: Sequence[GainSet], threads: int | None) -> list[Floats]:
    return _here(law, problem, several, threads, HELD)


def _short(law: Law, problem: Problem, several: Sequence[GainSet], threads: int | None) -> list[Floats]:
    return _here(law, problem, several, threads, SHORT)


def _here(
    law: Law, problem: Problem, several: Sequence[GainSet], threads: int | None, held: float
) -> list[Floats]:
    period, count = number(problem.values, "sample_period"), len(problem.plants)
    motion, first = tried(period, problem.motions, held)
    bare = problem._replace(preview=False, delivery=None)
    quiet = batch.records([registry.plant_of(p).quiet(p) for p in problem.plants])
    values = [trial.values_with(problem, gains) for gains in several]
    params = [trial.built(law, v) for v in values]
    led = [
        trial.given(law, p, v, gains, bare, motion)
        for p, v, gains in zip(params, values, several, strict=True)
    ]
    loops = batch.records([linearisation.behind(v, p) for v, p in zip(values, params, strict=True)])
    traces = np.empty((len(several) * count, len(motion), 3))
    batch.simulate(
        batch.Batch(
            law.name,
            np.repeat(loops, count),
            np.tile(quiet, len(several)),
            np.tile(np.arange(count), len(several)),
            np.broadcast_to(motion, traces.shape[:2]),
            led=np.repeat(np.array(led), count, axis=0),
        ),
        threads,
        traces,
    )
    with np.errstate(invalid="ignore"):
        answer = steps.answer(motion[first - 1 :], traces[:, first - 1 :, 0], period)
    assert answer is not None, "steps are steps"
    rows = np.nan_to_num(np.array(answer), nan=math.inf, posinf=math.inf)
    return [rows[:, None, i * count : (i + 1) * count] for i in range(len(several))]
