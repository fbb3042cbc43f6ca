# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tries sets of gains of a law: margins over a box of valves, and runs of many valves on several commands."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.laws import command_lead, linearisation, reshaping
from valve_control.control.laws.free import Free, placed
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant.models import D3FXE, Scale
from valve_control.control.simulation import batch, delivery
from valve_control.control.simulation.cluster import Cluster
from valve_control.control.simulation.delivery import Delivery
from valve_control.design.tuning.kept import Kept, digest
from valve_control.parameter import Value, Values, number, updated

Workers = int | Cluster | Kept | None  # threads here (None: all cores), a cluster, or what was done before
AHEAD = Free("preview", 0.0, 0.03, logarithmic=False)  # s  by which a known motion is sent ahead, unreshaped
TAIL = 95  # %


class TuningMotion(NamedTuple):
    """One wanted motion of the spool, which the upper level commands."""

    name: str
    wanted: Floats  # V  one entry a sample


class TuningLimits(NamedTuple):
    """What is asked for on every valve of the box, but for ``saturated``, which is a mean.

    Not asked for: 0.0 of what is to be large, infinite for what is to be small.
    """

    gain_db: float
    phase_deg: float
    delay_s: float
    sensitivity_db: float  # at most
    swing: float  # V  at most; amplitude of swings about rest that friction sustains, by the loop
    saturated: float  # at most; share of the samples at the limit of the voltage
    pause_s: float = 0.0  # s  of the command, after which the reference comes back; pauses.shortest is longer
    overshoot: float = math.inf  # -  of steps, at most, median of the valves


USUAL = TuningLimits(
    gain_db=3.0,
    phase_deg=20.0,
    delay_s=0.0005,
    sensitivity_db=12.0,
    swing=0.04,
    saturated=0.02,
    pause_s=0.01,
)  # where nothing else is asked for
OVERSHOOT = 0.05  # -  that is asked for of a reference that brakes in time


class Problem(NamedTuple):
    """What gains are tried on."""

    values: Values  # the controller's; what is not chosen stays
    motions: Sequence[TuningMotion]
    plants: Sequence[Any]  # that are simulated
    box: Sequence[Any]  # around which the margins have to hold
    limits: TuningLimits
    preview: bool  # whether the motions are known ahead, so that reshaping causes no lag
    largest: bool  # whether the error is the largest of a run, instead of its rms
    seed: int  # of the noise
    strict: bool = False  # whether a voltage that a node reports counts where the spool swings by itself
    scale: Scale = D3FXE  # of the valve, with which the ranges go
    delivery: Delivery | None = None  # of commands that are not previewed; None: one a sample, in time


class GainSet(NamedTuple):
    """One set of gains."""

    changes: Mapping[str, Value]  # of the controller's values
    ahead: float  # s  see AHEAD


class TrialResult(NamedTuple):
    """One set of gains on N valves and M motions: arrays M×N; NaN where a run did not stay finite."""

    e_rms: Floats  # V  of the true position
    e_max: Floats  # V  likewise
    c_u: Floats  # -  chatter
    saturated: Floats  # -  share of the samples

    @property
    def chatter(self) -> float:
        """Mean of c_u."""
        return float(np.mean(self.c_u))


Here = Callable[[Law, Problem, Sequence[GainSet], int | None], list[Floats]]  # on threads of this machine


def typical(errors: Floats) -> float:
    """One number [V] for errors M×N: geometric mean over M of that of median and 95th percentile over N.

    Infinite if one of them is not finite.
    """
    if not np.all(np.isfinite(errors)):
        return math.inf
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(np.percentile(errors, [50, TAIL], axis=1)))))


def error_of(problem: Problem, outcome: TrialResult) -> float:
    """The error [V] that the search makes small."""
    return typical(outcome.e_max if problem.largest else outcome.e_rms)


def free_numbers(law: Law, values: Values, preview: bool, scale: Scale = D3FXE) -> tuple[Free, ...]:
    """The numbers that may be chosen with these ``values`` of the controller, on a valve of this ``scale``.

    A motion that is known ahead needs no lead, and the frequency of the reshaping then has no effect.
    """
    own = tuple(free.ranged(scale) for free in law.free if free.matters(values))
    if not own:
        return ()
    reshapes = law.reshapes(law.build(values))
    if preview:
        return own if reshapes else (*own, AHEAD)
    if not reshapes:
        return (*own, reshaping.LEAD.ranged(scale), reshaping.LEAD_ACCEL)
    lead = reshaping.lead(values, scale, law.lag)
    return (*own, reshaping.frequency(values, scale), lead, reshaping.LEAD_ACCEL)


def gains_at(free: Sequence[Free], values: Values, shares: Sequence[float]) -> GainSet:
    """Gains at the point ``shares`` of the unit cube."""
    chosen = [(f, f.from_share(share)) for f, share in zip(free, shares, strict=True)]
    ahead = next((value for f, value in chosen if f is AHEAD), 0.0)
    return GainSet(placed([(f, value) for f, value in chosen if f is not AHEAD], values), ahead)


def values_with(problem: Problem, gains: GainSet) -> Values:
    """The controller's values with ``gains``. Raises ParameterError."""
    return updated(CONTROLLER, problem.values, gains.changes)


def built(law: Law, values: Values) -> Any:
    """Parameters of ``law`` with ``values`` of the controller; the latest are kept. Raises ParameterError."""
    return _built(law.build, tuple((n, tuple(v) if isinstance(v, list) else v) for n, v in values.items()))


@functools.lru_cache(maxsize=256)
def _built(build: Callable[[Values], Any], items: tuple[tuple[str, Any], ...]) -> Any:
    return build({name: list(value) if isinstance(value, tuple) else value for name, value in items})


def given(law: Law, params: Any, values: Values, gains: GainSet, problem: Problem, wanted: Floats) -> Floats:
    """Commands [V] as the law gets them for the motion ``wanted`` [V]."""
    limit = number(values, "command_limit")
    if not problem.preview:
        lead = command_lead.build(values, law.reshapes(params))
        return delivery.led(lead, values, np.clip(wanted, -limit, limit), problem.delivery)
    if law.reshapes(params):
        after = wanted[-1] + (wanted[-1] - wanted[-2]) * np.arange(1, 3)  # goes on straight at its end
        return delivery.unreshaped(params.reshaping, np.concatenate([wanted, after]))
    steps = np.arange(len(wanted), dtype=np.float64)
    return np.interp(steps + gains.ahead / number(values, "sample_period"), steps, wanted)


def threads_of(workers: Workers) -> int | None:
    """Threads for what is done here."""
    if isinstance(workers, Kept):
        return threads_of(workers.workers)
    return None if isinstance(workers, Cluster) else workers


def run(law: Law, problem: Problem, several: Sequence[GainSet], workers: Workers = None) -> list[TrialResult]:
    """Results of ``several`` sets of gains on all plants and motions of ``problem``."""
    return [TrialResult(*rows) for rows in shared(run_here, law, problem, several, workers)]


def shared(
    here: Here, law: Law, problem: Problem, several: Sequence[GainSet], workers: Workers
) -> list[Floats]:
    """What ``here`` computes for each of ``several``: on threads, on a cluster, or from what is kept."""
    if isinstance(workers, Kept):
        key = digest((here.__name__, law.name, problem.values, problem.seed, len(problem.plants), several))
        there = workers.workers
        return list(workers.outcomes(key, lambda: np.array(shared(here, law, problem, several, there))))
    if not isinstance(workers, Cluster) or len(several) == 1:
        return here(law, problem, several, threads_of(workers))
    each = -(-len(several) // workers.slots)
    parts = [several[first : first + each] for first in range(0, len(several), each)]
    made: list[list[Floats]] = [[] for _ in parts]
    for i, rows in workers.completed(_there, [(here, law.name, problem, part) for part in parts]):
        made[i] = rows
    return [row for part in made for row in part]


def _there(here: Here, law: str, problem: Problem, several: Sequence[GainSet]) -> list[Floats]:
    """``here`` on a worker, on one thread."""
    return here(LAWS[law], problem, several, 1)


def run_here(
    law: Law, problem: Problem, several: Sequence[GainSet], threads: int | None = None
) -> list[Floats]:
    """Rows of the results (4×M×N) of all plants of ``problem`` with each of ``several`` gains.

    All sets go through the compiled loop together, and the result does not depend on the number of
    threads. Valve i has noise seed ``problem.seed`` + i, and another one on each motion.
    """
    count = len(problem.plants)
    plants = np.tile(batch.records(list(problem.plants)), len(several))
    values = [values_with(problem, gains) for gains in several]
    params = [built(law, v) for v in values]
    loops = [linearisation.behind(v, p) for v, p in zip(values, params, strict=True)]
    laws = np.repeat(batch.records(loops), count)
    found = []
    for i, motion in enumerate(problem.motions):
        led = [
            given(law, p, v, gains, problem, motion.wanted)
            for p, v, gains in zip(params, values, several, strict=True)
        ]
        seeds = np.tile(problem.seed + 1000 * i + np.arange(count), len(several))
        result = batch.simulate(
            batch.Batch(
                law.name,
                laws,
                plants,
                seeds,
                np.broadcast_to(motion.wanted, (len(seeds), len(motion.wanted))),
                led=np.repeat(np.array(led), count, axis=0),
            ),
            threads,
        )
        rows = (result.true_e_rms, result.true_e_M, result.c_u, result.saturated)
        found.append([row.reshape(len(several), count) for row in rows])
    return [np.array([[rows[k][j] for rows in found] for k in range(4)]) for j in range(len(several))]


def violation(limits: TuningLimits, found: margins.Margins, share: float = 1.0) -> float:
    """By how much the worst valve misses the ``limits``, times ``share`` the margins; 0.0: they hold.

    Sum of what is missing of each as a part of it; an unstable loop misses more than any stable one.
    """
    unstable = float(np.max(found.radius)) - 1.0
    if unstable >= margins.EDGE:
        return 10.0 + 100.0 * unstable
    missing = 0.0
    for name in ("gain_db", "phase_deg", "delay_s"):
        wanted = getattr(limits, name) * share
        if wanted > 0.0:
            missing += max(0.0, 1.0 - float(np.min(getattr(found, name))) / wanted)
            if name == "gain_db":
                missing += max(0.0, 1.0 - float(np.min(found.reduction_db)) / wanted)
    most = limits.sensitivity_db / share
    missing += max(0.0, float(np.max(found.sensitivity_db)) / most - 1.0)
    swing = float(np.max(found.swing_v)) / (limits.swing / share)
    return missing + (math.log(swing) if swing > 1.0 else 0.0)
