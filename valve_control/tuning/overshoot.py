"""Tries how valves answer steps of the command: overshoot and settling time of a set of gains.

The valves are those of a problem, without noise of the LVDT: it is the law that is judged. The first of the
steps is left out, in which laws that adapt learn the valve.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from valve_control.analysis import steps
from valve_control.laws.law import Law
from valve_control.parameter import number
from valve_control.plant import valve
from valve_control.simulation import batch
from valve_control.tuning import limit_cycles, trial
from valve_control.tuning.trial import Gains, Problem, Workers

Array = npt.NDArray[np.float64]


def answers(
    law: Law, problem: Problem, several: Sequence[Gains], workers: Workers = None
) -> list[tuple[float, float]]:
    """Overshoot [-] and settling time [s] with each of ``several``: medians of the valves' worst steps.

    Infinite where a run does not stay finite, or does not settle.
    """
    found = trial.shared(_here, law, problem, several, workers)
    return [(float(row[0, 0, 0]), float(row[1, 0, 0])) for row in found]


def _here(law: Law, problem: Problem, several: Sequence[Gains], threads: int | None) -> list[Array]:
    period = number(problem.values, "sample_period")
    motion = limit_cycles.steps(period, problem.motions, limit_cycles.FARTHER).wanted
    first, _ = steps.places(motion, period)[1]
    bare = problem._replace(preview=False, delivery=None)
    quiet: list[valve.Params] = [p._replace(lvdt=p.lvdt._replace(noise=0.0)) for p in problem.plants]
    plants, count = batch.records(quiet), len(quiet)
    made = []
    for gains in several:
        values = trial.values_with(problem, gains)
        params = trial.built(law, values)
        led = trial.given(law, params, values, gains, bare, motion)
        traces = np.empty((count, len(motion), 3))
        wide = np.broadcast_to(motion, (count, len(motion)))
        laws = np.repeat(batch.records([params]), count)
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
