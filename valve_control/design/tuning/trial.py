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
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant.transfer_functions import D3FXE, Scale
from valve_control.control.simulation import batch, delivery
from valve_control.control.simulation.delivery import Delivery
from valve_control.parameter import Value, Values, number, updated

Threads = int | None  # None: all cores
AHEAD = Free("preview", 0.0, 0.03, logarithmic=False)  # s  by which a known motion is sent ahead, unreshaped
TAIL = 95  # %
SEEDS_OF_A_MOTION = 1000


class TuningMotion(NamedTuple):
    """One wanted motion of the spool, which the upper level commands."""

    name: str
    wanted: Floats  # V  one entry a sample


class TuningLimits(NamedTuple):
    """What is asked for on every valve of the box, but for ``saturated``, which is a mean.

    Not asked for: 0.0 of what is to be large, infinite for what is to be small.
    """

    gain_db: float = 3.0
    phase_deg: float = 20.0
    delay_s: float = 0.0005
    sensitivity_db: float = 12.0  # at most
    swing: float = 0.04  # V  at most; amplitude of swings about rest that friction sustains, by the loop
    saturated: float = 0.02  # at most; share of the samples at the limit of the voltage
    pause_s: float = 0.01  # s  of the command, after which the reference comes back
    overshoot: float = math.inf  # -  of steps, at most, median of the valves


USUAL = TuningLimits()


class Problem(NamedTuple):
    """What gains are tried on."""

    values: Values  # the controller's; what is not chosen stays
    motions: Sequence[TuningMotion]
    plants: Sequence[Any]  # that are simulated
    box: Sequence[Any]  # around which the margins have to hold
    limits: TuningLimits
    preview: bool  # whether the motions are known ahead, so that reshaping causes no lag
    seed: int  # of the noise
    strict: bool = False  # whether a voltage that a node reports counts where the spool swings by itself
    scale: Scale = D3FXE  # of the valve, with which the ranges go
    delivery: Delivery | None = None  # of commands that are not previewed; None: one a sample, in time

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return number(self.values, "sample_period")


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

    @property
    def error(self) -> float:
        """Error [V] that a search makes small: ``typical`` of the rms values."""
        return typical(self.e_rms)


def typical(errors: Floats) -> float:
    """One number [V] for errors M×N: geometric mean over M of that of median and 95th percentile over N.

    Infinite if one of them is not finite.
    """
    if not np.all(np.isfinite(errors)):
        return math.inf
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(np.percentile(errors, [50, TAIL], axis=1)))))


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


class Loops:
    """``several`` sets of gains of one law on N ``plants``: loop i is that of plant i % N.

    All loops of a call go through the compiled loop together; no result depends on the number of threads.
    Raises ParameterError for gains that the law cannot be built with.
    """

    def __init__(
        self, law: Law, problem: Problem, several: Sequence[GainSet], plants: Sequence[Any], seed: int
    ) -> None:
        self._law, self._problem, self._several = law, problem, several
        self._values = [values_with(problem, gains) for gains in several]
        self._params = [built(law, values) for values in self._values]
        behind = zip(self._values, self._params, strict=True)
        self._laws = batch.records([linearisation.behind(values, params) for values, params in behind])
        self._plants, self._seed = batch.records(list(plants)), seed
        self.count = len(several) * len(plants)

    def commands(self, wanted: Floats, sender: Problem | None = None) -> Floats:
        """Commands [V] for the motion ``wanted`` [V] as the law gets them, one row for each set of gains.

        ``sender``: the problem that says how they come, if it is another one.
        """
        sender, rows = sender or self._problem, []
        for params, values, gains in zip(self._params, self._values, self._several, strict=True):
            if not sender.preview:
                limit = number(values, "command_limit")
                lead = command_lead.build(values, self._law.reshapes(params))
                rows.append(delivery.led(lead, values, np.clip(wanted, -limit, limit), sender.delivery))
            elif self._law.reshapes(params):
                after = wanted[-1] + (wanted[-1] - wanted[-2]) * np.arange(1, 3)  # on straight at its end
                rows.append(delivery.unreshaped(params.reshaping, np.concatenate([wanted, after])))
            else:
                steps = np.arange(len(wanted), dtype=np.float64)
                rows.append(np.interp(steps + gains.ahead / sender.period, steps, wanted))
        return np.array(rows)

    def run(
        self,
        wanted: Floats,
        led: Floats,
        threads: Threads,
        which: slice = slice(None),
        traces: Floats | None = None,
        later: int = 0,
    ) -> Any:
        """Results of the loops ``which`` for the ``wanted`` motion [V] and the commands ``led`` of all gains.

        ``traces``: see ``batch.simulate``. ``later`` is added to the seed of the noise, which is one for each
        plant.
        """
        loops, n = np.arange(self.count)[which], len(self._plants)
        return batch.simulate(
            batch.Batch(
                self._law.name,
                self._laws[loops // n],
                self._plants[loops % n],
                self._seed + later + loops % n,
                np.broadcast_to(wanted, (len(loops), len(wanted))),
                led=led[loops // n],
            ),
            threads,
            traces,
        )


def run(law: Law, problem: Problem, several: Sequence[GainSet], threads: Threads = None) -> list[TrialResult]:
    """Results of ``several`` sets of gains on all plants and motions of ``problem``.

    Valve i has noise seed ``problem.seed`` + i, and another one on each motion.
    """
    loops, rows = Loops(law, problem, several, problem.plants, problem.seed), []
    for i, motion in enumerate(problem.motions):
        led = loops.commands(motion.wanted)
        result = loops.run(motion.wanted, led, threads, later=SEEDS_OF_A_MOTION * i)
        rows.append([result.true_e_rms, result.true_e_M, result.c_u, result.saturated])
    by_gains = np.array(rows).reshape(len(rows), 4, len(several), -1).transpose(2, 1, 0, 3).copy()
    return [TrialResult(*one) for one in by_gains]
