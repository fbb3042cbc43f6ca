"""Theorems 1 B and 2 B as an experiment: parametric uncertainty only (d̃ = 0), z1 goes to zero.

The valves lie inside the package's default ranges of θ, the estimates start at the paper's θ̂(0). In
continuous time z1 → 0; in samples the held voltage is itself a disturbance of order ΔT. The estimates need
not converge: that takes a motion that excites all four of them. Γ balances the four ranges, so that the
limit shows within seconds. ARC's velocity is the true one. ±U_MAX is wide, since nothing is promised in
saturation.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.laws import reshaping
from valve_control.laws.projection import Theta
from valve_control.laws.signals import Start
from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, defaults, updated
from valve_control.simulation import closed_loop
from valve_control.theorems import bench, robust
from valve_control.theorems.bench import Array, Motion, Plant, Progress

PERIODS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5)  # s
DURATION = 30.0  # s
WINDOW = 0.5  # s; every motion repeats itself in it
U_MAX = 100.0  # V
ROUNDING = 1e-12  # V; below this z1 is rounding
GAMMA = [2.0, 1200.0, 500.0, 1500.0]  # diagonal of Γ, both laws
W = 2.0 * math.pi
MOTIONS = {
    "rest": Motion(1.0, 0.0, W, 0.0, W, 0.0, W),
    "one sine": Motion(-1.0, 1.0, 4.0 * W, 0.0, W, 0.0, W),
    "three sines": Motion(-1.05, 0.5, 2.0 * W, 0.3, 6.0 * W, 0.25, 14.0 * W),
}
LAWS = ("arc", "oarc")


class Cell(NamedTuple):
    """All valves under one law, motion and sample period."""

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
    """What is left of z1 over ΔT."""

    law: str
    motion: str
    periods: Array  # s
    residual: Array  # V
    order: float  # -  slope of log residual over log ΔT


class Study(NamedTuple):
    """Theorems 1 B and 2 B on random valves."""

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
    """Valve ``number`` of a seed: around (2), inside the default ranges."""
    rng = np.random.default_rng([seed, number])
    low, high = [20.0, 900.0, 1000.0, -600.0], [100.0, 2200.0, 2000.0, 600.0]
    return Theta(*(float(v) for v in rng.uniform(low, high)))


given = law_step = bench.missing  # of robust.LAWS, put in by loop_for


def run_valve(
    p: Any,
    s: Any,
    motion: Motion,
    valve: Plant,
    truth: Theta,
    x1: float,
    samples: int,
    per_window: int,
    z1_out: Array,
    theta_out: Array,
) -> float:
    """Run one valve from rest at ``x1`` [V]; returns the share of samples in saturation.

    ``z1_out`` (windows) takes the largest |z1| [V] of each window, ``theta_out`` (windows×4) θ̂ at its end.
    """
    x2 = 0.0
    saturated = 0
    for k in range(samples):
        position, rate, accel = bench.reference(motion, k * p.period)
        s = given(p, s, reshaping.State(position, rate), x1, x2)
        command = bench.command_for(p.reshaping, position, rate, accel)
        voltage, s, terms = law_step(p, s, command, x1, 0.0)
        if voltage != terms.unsaturated_voltage:
            saturated += 1
        window = k // per_window
        z1_out[window] = max(z1_out[window], abs(terms.z1))
        for i in range(4):
            theta_out[window, i] = s.theta[i]
        force = truth.b0 * voltage + truth.b0dn
        x1, x2 = (
            valve.m11 * x1 + valve.m12 * x2 + valve.g1 * force,
            valve.m21 * x1 + valve.m22 * x2 + valve.g2 * force,
        )
    return saturated / samples


def loop_for(law: str, compiled: bool = True) -> Callable[..., Any]:
    """``run_valve`` with the functions of ``law``, compiled or in plain Python."""
    functions = {name: getattr(robust.LAWS[law], name) for name in ("given", "law_step")}
    return bench.loop_with(run_valve, functions, compiled)


class Task(NamedTuple):
    """All valves of one cell."""

    law: str
    motion: str
    period: float  # s
    seed: int
    valves: int
    duration: float  # s


def run_cell(task: Task) -> Cell:
    """Run all valves of one cell."""
    changes = {"sample_period": task.period, "u_max": U_MAX, f"{task.law}.gamma": GAMMA}
    p: Any = build.LAW_PARAMS[task.law](updated(CONTROLLER, defaults(CONTROLLER), changes))
    p = p._replace(reshaping=bench.unlimited(task.period))
    if task.law == "arc":
        p = p._replace(velocity=bench.KEEPS_VELOCITY)
    law = closed_loop.LAWS[task.law]
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
        saturated[i] = loop(
            p,
            s,
            motion,
            bench.plant(truth, task.period),
            truth,
            x1,
            windows * per_window,
            per_window,
            z1[i],
            theta[i],
        )
        start[i] = np.subtract(p.theta_initial, truth) / width
        theta[i] = (theta[i] - np.array(truth)) / width
    distance = np.linalg.norm(theta, axis=2) / np.linalg.norm(start, axis=1)[:, None]
    return Cell(task.law, task.motion, task.period, z1, distance, np.abs(theta[:, -1]), saturated)


def study(
    valves: int = 40,
    seed: int = 1,
    laws: Sequence[str] = LAWS,
    motions: Sequence[str] = tuple(MOTIONS),
    periods: Sequence[float] = PERIODS,
    duration: float = DURATION,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Study:
    """Theorems 1 B and 2 B on ``valves`` random valves per law, motion and sample period [s].

    ``progress(done, all)`` counts cells.
    """
    tasks = [
        Task(law, motion, period, seed, valves, duration)
        for law in laws
        for motion in motions
        for period in periods
    ]
    if jobs > 1:
        for law in laws:
            run_cell(Task(law, motions[0], 1e-3, seed, 1, WINDOW))  # fills numba's cache
    cells = bench.work(run_cell, tasks, jobs, progress)
    return Study(seed, valves, duration, WINDOW, tuple(cells))
