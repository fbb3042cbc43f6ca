# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tries how valves answer steps of the command: overshoot and settling time of a set of gains.

The valves are those of a problem, without noise of the LVDT: it is the law that is judged. The first of the
steps is left out, in which laws that adapt learn the valve. The others go out, back to 0 and part of the way
back, since estimates that have moved at a position answer the way back otherwise than the way out.
"""

from collections.abc import Sequence

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import steps
from valve_control.control.laws import linearisation
from valve_control.control.laws.law import Law
from valve_control.control.plant import registry
from valve_control.control.simulation import batch
from valve_control.design.tuning import limit_cycles, trial
from valve_control.design.tuning.trial import GainSet, Problem, TuningMotion, Workers
from valve_control.parameter import number

HEIGHTS = (0.1, -0.4, 0.0, 0.4, 0.0, 1.0, 0.4)  # of the reach of the motions; each is held for HELD


def answers(
    law: Law, problem: Problem, several: Sequence[GainSet], workers: Workers = None
) -> list[tuple[float, float]]:
    """Overshoot [-] and settling time [s] with each of ``several``: medians of the valves' worst steps.

    Infinite where a run does not stay finite, or does not settle.
    """
    found = trial.shared(_here, law, problem, several, workers)
    return [(float(row[0, 0, 0]), float(row[1, 0, 0])) for row in found]


def tried(period: float, motions: Sequence[TuningMotion]) -> Floats:
    """The steps [V], one entry a sample ``period`` [s]; they reach as far as the ``motions``."""
    n = round(limit_cycles.HELD / period)
    reach = max(float(np.max(np.abs(motion.wanted))) for motion in motions)
    return np.concatenate([np.zeros(n // 10), *(np.full(n, height * reach) for height in HEIGHTS)])


def _here(law: Law, problem: Problem, several: Sequence[GainSet], threads: int | None) -> list[Floats]:
    period = number(problem.values, "sample_period")
    motion = tried(period, problem.motions)
    first, _ = steps.places(motion, period)[1]
    bare = problem._replace(preview=False, delivery=None)
    quiet = [registry.plant_of(p).quiet(p) for p in problem.plants]
    plants, count = batch.records(quiet), len(quiet)
    made = []
    for gains in several:
        values = trial.values_with(problem, gains)
        params = trial.built(law, values)
        led = trial.given(law, params, values, gains, bare, motion)
        traces = np.empty((count, len(motion), 3))
        wide = np.broadcast_to(motion, (count, len(motion)))
        laws = np.repeat(batch.records([linearisation.behind(values, params)]), count)
        batch.simulate(
            batch.Batch(law.name, laws, plants, range(count), wide, led=np.broadcast_to(led, wide.shape)),
            threads,
            traces,
        )
        answer = steps.answer(motion[first - 1 :], traces[:, first - 1 :, 0], period)
        assert answer is not None, "steps are steps"
        middle = [float(np.median(np.nan_to_num(part, nan=np.inf, posinf=np.inf))) for part in answer]
        made.append(np.array(middle).reshape(2, 1, 1))
    return made
