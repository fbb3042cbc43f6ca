# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tries how valves answer steps of the command: overshoot and settling time of a set of gains.

The valves are those of a problem, without noise of the LVDT: it is the law that is judged. Of each step the
median of the valves counts, and of the steps the worst. The worst step of each valve would be an extreme: the
median of that is the 89th percentile of six steps.

First the spool follows a motion of the problem, and then the same steps. A law that adapts is another one
before: one small step does not tell offset, gain and the friction that holds the spool from each other, and a
part of the offset that counts as friction acts with the wrong sign when the spool turns back. The steps go
out, back to 0 and part of the way back, since estimates that have moved at a position answer the way back
otherwise than the way out.
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
HELD, SHORT = 1.0, 0.25  # s  that each is held, in verification and in a search
LEARNT = 1.0  # s  of the motion before


def answers(law: Law, problem: Problem, gains: GainSet, workers: Workers = None) -> Floats:
    """Overshoot [-] and settling time [s] (2×S×N) of N valves in S steps, with ``gains``.

    Infinite where a run does not stay finite, or does not settle within HELD.
    """
    return trial.shared(_held, law, problem, [gains], workers)[0]


def medians(law: Law, problem: Problem, several: Sequence[GainSet], workers: Workers = None) -> list[float]:
    """Overshoot [-] with each of ``several`` in steps that are held for SHORT: ``typical``."""
    return [typical(rows[0]) for rows in trial.shared(_short, law, problem, several, workers)]


def typical(rows: Floats) -> float:
    """The worst of S steps of what N valves make of them (S×N), medians of the valves."""
    return float(np.max(np.median(rows, axis=1)))


def tried(period: float, motions: Sequence[TuningMotion], held: float = HELD) -> tuple[Floats, int]:
    """Commands [V], one entry a sample ``period`` [s], and the number of the first that is judged.

    The steps reach as far as the ``motions``. Before them are the beginning of the one that goes farthest,
    and the same steps.
    """
    n = round(held / period)
    farthest = max(motions, key=lambda motion: float(np.max(np.abs(motion.wanted)))).wanted
    begins = int(np.argmax(farthest != farthest[0]))
    learnt = farthest[begins : begins + round(LEARNT / period)]
    reach = float(np.max(np.abs(farthest)))
    short = round(SHORT / period)
    parts = [np.zeros(short), learnt, np.zeros(short)]
    parts += [np.full(short, height * reach) for height in (*HEIGHTS, 0.0)]
    first = sum(map(len, parts))
    return np.concatenate([*parts, *(np.full(n, height * reach) for height in HEIGHTS)]), first


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
        found = steps.answers(motion[first - 1 :], traces[:, first - 1 :, 0], period)
    rows = np.nan_to_num(np.array(found).swapaxes(0, 1), nan=math.inf, posinf=math.inf)
    return [rows[:, :, i * count : (i + 1) * count] for i in range(len(several))]
