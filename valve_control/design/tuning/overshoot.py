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
from valve_control.control.laws.law import Law
from valve_control.control.plant import registry
from valve_control.design.tuning import trial
from valve_control.design.tuning.trial import GainSet, Problem, Threads

HEIGHTS = (-0.4, 0.0, 0.4, 0.0, 1.0, 0.4)  # of the reach of the motions
HELD, SHORT = 1.0, 0.25  # s  that each is held, in verification and in a search
LEARNT = 1.0  # s  of the motion before


def medians(law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None) -> list[float]:
    """Overshoot [-] with each of ``several`` in steps that are held for SHORT: ``typical``."""
    return [typical(rows[0]) for rows in answers(law, problem, several, threads, SHORT)]


def typical(rows: Floats) -> float:
    """The worst of S steps of what N valves make of them (S×N), medians of the valves."""
    return float(np.max(np.median(rows, axis=1)))


def answers(
    law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None, held: float = HELD
) -> list[Floats]:
    """Overshoot [-] and settling time [s] (2×S×N) of N valves in S steps, with each of ``several`` gains.

    Infinite where a run does not stay finite, or does not settle while a step is ``held`` [s]. The steps
    reach as far as the motions. Before them are the beginning of the one that goes farthest, and the same
    steps, which are not judged.
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
        found = steps.answers(motion[first - 1 :], traces[:, first - 1 :, 0], problem.period)
    rows = np.nan_to_num(np.array(found).swapaxes(0, 1), nan=math.inf, posinf=math.inf)
    return np.split(rows, len(several), axis=2)
