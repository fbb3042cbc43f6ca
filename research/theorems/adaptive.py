# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tests Theorems 1 B and 2 B: with parametric uncertainty only (d̃ = 0), z1 must go to zero.

The valves lie inside the package's default ranges of θ, the estimates start at the paper's θ̂(0). In
continuous time z1 → 0; in samples the held voltage is itself a disturbance of order ΔT. The estimates need
not converge: that takes a motion that excites all four of them. Γ balances the four ranges, so that the
limit shows within seconds. ARC's velocity is the true one. ±U_MAX is wide, since nothing is promised in
saturation.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from research.theorems import bench, robust
from research.theorems.bench import Array, CosineReference, Course, Plant, Progress, Spool, Wanted
from valve_control.control import closed_loop
from valve_control.control.laws import registry, reshaping
from valve_control.control.laws.projection import Theta
from valve_control.control.laws.signals import Start
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import defaults, updated

PERIODS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5)  # s
DURATION = 30.0  # s
WINDOW = 0.5  # s; every motion repeats itself in it
U_MAX = 100.0  # V
ROUNDING = 1e-12  # V; below this z1 is rounding
GAMMA = [2.0, 1200.0, 500.0, 1500.0]  # diagonal of Γ, both laws
W = 2.0 * math.pi
MOTIONS = {
    "rest": CosineReference(1.0, 0.0, W, 0.0, W, 0.0, W),
    "one sine": CosineReference(-1.0, 1.0, 4.0 * W, 0.0, W, 0.0, W),
    "three sines": CosineReference(-1.05, 0.5, 2.0 * W, 0.3, 6.0 * W, 0.25, 14.0 * W),
}
LAWS = ("arc", "oarc")


class Cell(NamedTuple):
    """Results of all valves under one law, motion and sample period."""

    law: str
    motion: str
    period: float  # s
    z1: Array  # V   valves × windows: largest |z1| in each window
    distance: Array  # -   valves × windows: ‖θ̃‖ over ‖θ̃(0)‖, each entry over its range, at the window's end
    entries: Array  # -   valves × 4: |θ̃| over its range at the end
    saturated: Array  # share of samples

    @property
    def residual(self) -> float:
        """Median over the valves of the largest |z1| [V] in the last window."""
        return float(np.median(self.z1[:, -1]))

    @property
    def first(self) -> float:
        """Median over the valves of the largest |z1| [V] in the first window."""
        return float(np.median(self.z1[:, 0]))

    @property
    def rate(self) -> float:
        """Median rate [1/s] at which |z1| decays: fit of the windows down to three times what is left.

        Of the valves that take at least two windows; NaN if none does.
        """
        rates = np.array([_rate(row) for row in self.z1])
        return float(np.median(rates[np.isfinite(rates)])) if np.any(np.isfinite(rates)) else math.nan

    @property
    def estimate_error(self) -> float:
        """Median of ‖θ̃‖ at the end over ‖θ̃(0)‖."""
        return float(np.median(self.distance[:, -1]))


class Order(NamedTuple):
    """How the error z1 that is left depends on ΔT."""

    law: str
    motion: str
    periods: Array  # s
    residual: Array  # V
    order: float  # -  slope of log residual over log ΔT


class Experiment(NamedTuple):
    """Results for Theorems 1 B and 2 B on random valves."""

    seed: int
    valves: int
    duration: float  # s
    window: float  # s
    cells: tuple[Cell, ...]

    def cell(self, law: str, motion: str, period: float) -> Cell:
        """Valves under ``law`` on ``motion`` at ``period`` [s]."""
        return next(c for c in self.cells if (c.law, c.motion, c.period) == (law, motion, period))

    def order(self, law: str, motion: str) -> Order:
        """Order in ΔT of what is left of z1."""
        cells = [c for c in self.cells if (c.law, c.motion) == (law, motion)]
        periods = np.array([c.period for c in cells])
        residual = np.array([c.residual for c in cells])
        return Order(law, motion, periods, residual, bench.order(periods, residual))


def _rate(windows: Array) -> float:
    settled = np.flatnonzero(windows < max(3.0 * float(windows[-1]), ROUNDING))
    n = int(settled[0]) if len(settled) else len(windows)
    return -float(np.polyfit(np.arange(n) * WINDOW, np.log(windows[:n]), 1)[0]) if n > 1 else math.nan


def draw(seed: int, number: int) -> Theta:
    """Parameters of valve ``number`` of a seed: around (2), inside the default ranges."""
    rng = np.random.default_rng([seed, number])
    low, high = [20.0, 900.0, 1000.0, -600.0], [100.0, 2200.0, 2000.0, 600.0]
    return Theta(*(float(v) for v in rng.uniform(low, high)))


class Valve(NamedTuple):
    """A valve without friction and limits, at one sample period."""

    step: Plant
    truth: Theta


given = law_step = bench.missing  # of robust.LAWS, put in by loop_for


def driven(p: Any, s: Any, wanted: Wanted, spool: Spool, offset: float) -> Any:
    """Step of the law, with the motion as its reference."""
    s = given(p, s, reshaping.State(wanted.position, wanted.rate), spool.x1, spool.x2)
    return law_step(p, s, wanted.command, spool.x1, offset)


def moved(p: Valve, s: Spool, voltage: float) -> Spool:
    """State of the valve one period later, exact."""
    return bench.moved(p.step, s, p.truth.b0 * voltage + p.truth.b0dn)


def saturations(p: float, count: float, now: closed_loop.Sample, spool: Spool) -> tuple[float, bool]:
    """Count the samples at the limit of the voltage."""
    return count + (1.0 if now.voltage != now.terms.unsaturated_voltage else 0.0), False


def shown(spool: Spool, now: closed_loop.Sample) -> tuple[float, float, float, float, float]:
    """Signals of a sample: the error z1 [V] and the estimates."""
    return now.terms.z1, now.terms.a1, now.terms.a0, now.terms.b0, now.terms.b0dn


class Outcome(NamedTuple):
    """Results of one run."""

    z1: Array  # V  largest |z1| of each window
    theta: Array  # windows×4  θ̂ at the end of each
    saturated: float  # -  share of the samples


def loop_for(law: str, compiled: bool = True) -> Callable[..., Outcome]:
    """``run_valve`` under ``law``, compiled or in plain Python."""
    functions = {name: getattr(robust.LAWS[law], name) for name in ("given", "law_step")}
    stepped = bench.loop_with(driven, functions, compiled)
    loop = bench.loop_on_motion(stepped, saturations, moved, shown, compiled)
    return functools.partial(run_valve, loop)


def run_valve(
    loop: Callable[..., Any],
    p: Any,
    s: Any,
    motion: CosineReference,
    valve: Valve,
    x1: float,
    windows: int,
    per_window: int,
) -> Outcome:
    """Run one valve from rest at ``x1`` [V] for so many ``windows`` of ``per_window`` samples."""
    samples = windows * per_window
    seen = np.zeros((samples, 5))
    parts = closed_loop.Parts(Course(motion, p.reshaping, p.period), p, valve, 0.0)
    begin = closed_loop.Parts(0.0, s, Spool(x1, 0.0), 0.0)
    numbers = np.arange(samples, dtype=np.float64)
    end = loop(parts, begin, numbers, np.zeros(samples), seen, np.zeros((0, len(s))))
    z1 = np.abs(seen[:, 0]).reshape(windows, per_window).max(axis=1)
    # The estimates at the end of a window are those with which the next one begins.
    theta = np.vstack([seen[per_window::per_window, 1:], end.law.theta])
    return Outcome(z1, theta, float(end.measure / samples))


class Task(NamedTuple):
    """Work for one process: all valves of one cell."""

    law: str
    motion: str
    period: float  # s
    seed: int
    valves: int
    duration: float  # s


def run_cell(task: Task) -> Cell:
    """Run all valves of one cell."""
    changes = {"sample_period": task.period, "u_max": U_MAX, f"{task.law}.gamma": GAMMA}
    p: Any = registry.LAWS[task.law].build(updated(CONTROLLER, defaults(CONTROLLER), changes))
    p = p._replace(reshaping=bench.unlimited(task.period))
    if task.law == "arc":
        p = p._replace(velocity=bench.KEEPS_VELOCITY)
    law = registry.LAWS[task.law].module
    motion = MOTIONS[task.motion]
    per_window = round(WINDOW / task.period)
    windows = max(1, round(task.duration / WINDOW))
    width = np.subtract(p.theta_max, p.theta_min)
    loop = loop_for(task.law)
    z1 = np.zeros((task.valves, windows))
    theta = np.zeros((task.valves, windows, 4))
    start = np.zeros((task.valves, 4))
    saturated = np.zeros(task.valves)
    for i in range(task.valves):
        truth = draw(task.seed, i)
        x1 = motion.start
        holding = (truth.a0 * x1 - truth.b0dn) / truth.b0
        s = law.initial(p, Start(x1, holding, x1, 0.0, 0.0))
        outcome = loop(p, s, motion, Valve(bench.plant(truth, task.period), truth), x1, windows, per_window)
        z1[i], saturated[i] = outcome.z1, outcome.saturated
        start[i] = np.subtract(p.theta_initial, truth) / width
        theta[i] = (outcome.theta - np.array(truth)) / width
    distance = np.linalg.norm(theta, axis=2) / np.linalg.norm(start, axis=1)[:, None]
    return Cell(task.law, task.motion, task.period, z1, distance, np.abs(theta[:, -1]), saturated)


def experiment(
    valves: int = 40,
    seed: int = 1,
    laws: Sequence[str] = LAWS,
    motions: Sequence[str] = tuple(MOTIONS),
    periods: Sequence[float] = PERIODS,
    duration: float = DURATION,
    processes: int = 1,
    progress: Progress | None = None,
) -> Experiment:
    """Test Theorems 1 B and 2 B on ``valves`` random valves per law, motion and sample period [s].

    ``progress(done, all)`` counts cells.
    """
    tasks = [
        Task(law, motion, period, seed, valves, duration)
        for law in laws
        for motion in motions
        for period in periods
    ]
    if processes > 1:
        for law in laws:
            run_cell(Task(law, motions[0], 1e-3, seed, 1, WINDOW))  # fills numba's cache
    cells = bench.work(run_cell, tasks, processes, progress)
    return Experiment(seed, valves, duration, WINDOW, tuple(cells))
