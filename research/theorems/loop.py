# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds where dcarc's loop is stable: poles and a small-gain bound on thousands of random valves.

Between two steps of the fit, and without saturation, law and valve without friction are one linear sampled
system: the observer, and a valve of other gain, speed, dead time and flow force than its model. Weight θ1
scales feedback and feedforward alike, so that gain·(1 + θ1) is the gain of the loop. The boxes of valves are
those of docs/explanation/laws/dcarc.md; they are drawn larger and smaller, to show where the loop breaks and
what of the valve breaks it.

Matrices and responses are derived from the law's numbers here, apart from ``control.linear``, which
differentiates the law's step: test/theorems/test_experiments.py compares both.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg

from research.theorems import bench
from research.theorems.bench import Array, Progress
from valve_control.control.laws import dcarc
from valve_control.control.laws.dcarc_parts import Row
from valve_control.control.parameters import files, ros_file
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, TransferFunction
from valve_control.control.plant.valve import realisation
from valve_control.parameter import Values, defaults, updated

Complex = npt.NDArray[np.complex128]
PERIOD = 1e-3  # s
ORDER = 4
PAST = 4  # positions on their way to the reading that the observer has room for
STATES = len(Row._fields)  # of the model that the observer has room for
OBSERVER = STATES + 1 + PAST
GAIN, SPEED, DELAY, FLOW = (0.7, 1.4), (0.8, 1.25), (0.0, 1e-3), (-0.5, 0.5)  # -, -, s, V/V
SCALES = (0.5, 1.0, 1.5, 2.0)
CAUSES = ("gain", "poles", "zeros", "delay", "flow")
WEIGHTS = 3  # values of θ1 tried from one of its bounds to the other
FREQUENCIES = np.geomspace(0.1, 499.9, 240)  # Hz  of the small-gain bound
EXCITED = np.geomspace(0.5, 250.0, 55)  # Hz  at which a motion may excite the regressor
SHIPPED = {"shipped": (), "tuned narrow": ("narrow_0.25",), "tuned wide": ("wide_0.25",)}
BOXES = ("narrow", "wide")
THETAS = ("initial", "learned", "worst")  # θ1 with which poles are computed, fields of Cell


class Valves(NamedTuple):
    """N valves around model (3), over which these numbers are factors; entries of shape (N)."""

    gain: Array
    poles: Array  # of their speed
    zeros: Array  # of their speed
    delay: Array  # s
    flow: Array  # V/V


class Plants(NamedTuple):
    """Valves with their dead time, sampled: x⁺ = A·x + b·gain·u, y = c·x."""

    a: Array  # N×n×n
    b: Array  # N×n
    c: Array  # N×n


class Cell(NamedTuple):
    """One set of gains on all valves of one box, drawn ``scale`` times as large."""

    gains: str
    box: str
    scale: float
    initial: Array  # largest modulus of the poles with θ1 as at the start
    learned: Array  # with θ1 as it makes good the valve's gain, as far as its bounds let it
    worst: Array  # with any θ1 within its bounds
    bound: Array  # small-gain bound with θ1 as learned; below 1 the loop is proven to be stable
    teaching: Array  # Hz  up to which the weights learn the right way, NaN where the loop is unstable
    rescued: dict[str, int]  # valves unstable with the learned θ1 that would be stable but for this

    def unstable(self, name: str) -> int:
        """Valves with a pole outside the unit circle; ``name``: of THETAS."""
        return int(np.sum(getattr(self, name) >= 1.0))


class Study(NamedTuple):
    """Results for all gains, boxes and scales."""

    seed: int
    valves: int
    cells: tuple[Cell, ...]

    def cell(self, gains: str, box: str, scale: float) -> Cell:
        """Results of one combination."""
        return next(c for c in self.cells if (c.gains, c.box, c.scale) == (gains, box, scale))


def draw(seed: int, count: int, box: str, scale: float) -> Valves:
    """``count`` valves of a seed, the same at each ``scale`` but for how far they are from the model."""
    random = np.random.default_rng(seed)
    gain, poles, zeros, delay, flow = (
        random.uniform(*limits, count) for limits in (GAIN, SPEED, SPEED, DELAY, FLOW)
    )
    if box == "narrow":
        poles, zeros, delay = np.ones(count), np.ones(count), np.zeros(count)
    return Valves(gain**scale, poles**scale, zeros**scale, scale * delay, scale * flow)


def sampled(valves: Valves, period: float = PERIOD) -> Plants:
    """The valves with their voltage held over ``period`` [s], exactly, and their dead time, of any length.

    The flow force is that of the simulated valve: of the position at the beginning of the period.
    """
    count = len(valves.gain)
    whole = np.zeros((count, ORDER + 1, ORDER + 1))
    for i in range(count):
        a, b = realisation(model(float(valves.poles[i]), float(valves.zeros[i])))
        whole[i, :ORDER, :ORDER], whole[i, :ORDER, ORDER] = a, b
    waits = np.maximum(1, np.ceil(valves.delay / period - 1e-9)).astype(int)
    within = waits * period - valves.delay
    over = scipy.linalg.expm(whole * period)
    part = scipy.linalg.expm(whole * within[:, None, None])
    size = ORDER + int(np.max(waits))
    a, b, c = np.zeros((count, size, size)), np.zeros((count, size)), np.zeros((count, size))
    a[:, :ORDER, :ORDER], b[:, :ORDER] = over[:, :ORDER, :ORDER], over[:, :ORDER, ORDER]
    a[:, ORDER, :ORDER], b[:, ORDER] = part[:, 0, :ORDER], part[:, 0, ORDER]
    for i in range(ORDER + 1, size):
        a[:, i, i - 1] = 1.0
    a[:, :, 0] -= b * (valves.gain * valves.flow)[:, None]
    c[np.arange(count), ORDER + waits - 1] = 1.0
    return Plants(a, b, c)


def model(poles: float, zeros: float) -> TransferFunction:
    """Model (3) with its poles and zeros so many times as fast, and its static gain."""
    denominator = tuple(c * poles**i for i, c in enumerate(FOURTH_ORDER.denominator))
    numerator = [c * zeros**i for i, c in enumerate(FOURTH_ORDER.numerator)]
    scale = FOURTH_ORDER.static_gain * denominator[-1] / numerator[-1]
    return TransferFunction(tuple(scale * c for c in numerator), denominator)


class Feedback(NamedTuple):
    """The law at rest as a linear system: ẑ⁺ = Φ·ẑ + Γ·y, u = -H·ẑ - J·y; d̂ = e7·(ẑ + L·(y - c·ẑ))."""

    phi: Array
    gamma: Array
    h: Array
    j: float
    gain: Array  # L
    c: Array


def feedback(p: dcarc.Params) -> Feedback:
    """Observer and LQR of the law, from the numbers that its step uses."""
    m, past = p.model, slice(STATES + 1, OBSERVER)
    a, b, c = np.zeros((OBSERVER, OBSERVER)), np.zeros(OBSERVER), np.zeros(OBSERVER)
    a[:STATES, :STATES] = (m.row0, m.row1, m.row2, m.row3, m.row4, m.row5)
    b[:STATES], b[STATES + 1] = m.input, m.passing_input
    a[STATES + 1, :STATES] = m.passing
    for i in range(STATES + 2, OBSERVER):
        a[i, i - 1] = 1.0
    a[:, STATES] += b
    a[:STATES, STATES] += m.force
    a[STATES + 1, STATES] += m.passing_force
    a[STATES, STATES] = 1.0
    c[0], c[past] = m.present, m.shown
    gain = np.concatenate([p.kalman.state, [p.kalman.disturbance], p.kalman.past])
    k = np.concatenate([p.feedback, [1.0], np.zeros(PAST)])
    moved = a - np.outer(b, k)
    corrected = np.eye(OBSERVER) - np.outer(gain, c)
    return Feedback(moved @ corrected, moved @ gain, k @ corrected, float(k @ gain), gain, c)


def closed(law: Feedback, plants: Plants, gain: Array) -> Array:
    """Transition matrices of valve and observer in the loop; ``gain``: of the loop, gain·(1 + θ1)."""
    count, size = plants.b.shape
    whole = np.zeros((count, size + OBSERVER, size + OBSERVER))
    pushed = plants.b * gain[:, None]
    whole[:, :size, :size] = plants.a - law.j * pushed[:, :, None] * plants.c[:, None, :]
    whole[:, :size, size:] = -pushed[:, :, None] * law.h
    whole[:, size:, :size] = law.gamma[:, None] * plants.c[:, None, :]
    whole[:, size:, size:] = law.phi
    return whole


def radii(law: Feedback, plants: Plants, gain: Array) -> Array:
    """Largest modulus of the loop's poles of each valve, ``gain`` as in ``closed``."""
    radius: Array = np.max(np.abs(np.linalg.eigvals(closed(law, plants, gain))), axis=1)
    return radius


def responses(plants: Plants, z: Complex) -> Complex:
    """Frequency responses c·(z - A)⁻¹·b, N×len(z)."""
    size = plants.b.shape[1]
    found = np.empty((len(plants.b), len(z)), dtype=np.complex128)
    for i, point in enumerate(z):
        state = np.linalg.solve(point * np.eye(size) - plants.a, plants.b[:, :, None])[:, :, 0]
        found[:, i] = np.sum(plants.c * state, axis=1)
    return found


def answers(law: Feedback, z: Complex) -> Complex:
    """Frequency response from the reading to -u."""
    states = [np.linalg.solve(point * np.eye(OBSERVER) - law.phi, law.gamma) for point in z]
    found = np.array(states, dtype=np.complex128) @ law.h + law.j
    return found.astype(np.complex128)


def circle(frequencies: Array, period: float = PERIOD) -> Complex:
    """Points exp(jωΔT) of the unit circle."""
    found: Complex = np.exp(2j * math.pi * period * frequencies)
    return found


def small_gain(law: Feedback, plants: Plants, gain: Array, nominal: Plants) -> Array:
    """Largest |T·Δ| of each valve over the frequencies, Δ: relative difference of the valve to ``nominal``.

    T is the loop's complementary sensitivity on the nominal valve. Where the nominal loop is stable and the
    valve by itself has no more unstable poles than its model, less than 1 leaves the number of encirclements
    of -1 as it is, and the loop is stable.
    """
    z = circle(FREQUENCIES)
    own = responses(nominal, z)[0]
    loop = answers(law, z) * own
    relative = gain[:, None] * responses(plants, z) / own - 1.0
    bound: Array = np.max(np.abs(loop / (1.0 + loop) * relative), axis=1)
    own_poles = np.max(np.abs(np.linalg.eigvals(plants.a)), axis=1)
    bound[own_poles >= 1.0] = math.inf
    return bound


def teaching(law: Feedback, plants: Plants, gain: Array, lag_share: float) -> Array:
    """Frequency [Hz] of each valve up to which slow learning goes the right way, at most the last of EXCITED.

    A disturbance w at the input shows in d̂ through F, the fit expects it through the lag
    Λ = share/(z - 1 + share). On average the weights move against their error where Re(F·conj(Λ)) > 0.
    """
    z = circle(EXCITED)
    late = lag_share / (z - 1.0 + lag_share)
    right = (shown_disturbance(law, plants, gain, z) * np.conj(late)).real > 0.0
    upto = np.logical_and.accumulate(right, axis=1)
    highest: Array = np.max(upto * EXCITED, axis=1)
    return highest


def shown_disturbance(law: Feedback, plants: Plants, gain: Array, z: Complex) -> Complex:
    """F: frequency responses of d̂ to a voltage added at the input of each valve, N×len(z)."""
    count, size = plants.b.shape
    whole = closed(law, plants, gain)
    shown = np.zeros((count, size + OBSERVER))
    shown[:, :size] = law.gain[STATES] * plants.c
    shown[:, size:] = np.eye(OBSERVER)[STATES] - law.gain[STATES] * law.c
    pushed = np.zeros((count, size + OBSERVER, 1))
    pushed[:, :size, 0] = plants.b
    found = np.empty((count, len(z)), dtype=np.complex128)
    for i, point in enumerate(z):
        state = np.linalg.solve(point * np.eye(size + OBSERVER) - whole, pushed)[:, :, 0]
        found[:, i] = np.sum(shown * state, axis=1)
    return found


def learned_weight(p: dcarc.Params, valve_gain: Array) -> Array:
    """θ1 that makes good the gain of a valve, as far as its bounds let it."""
    found: Array = np.clip(1.0 / valve_gain - 1.0, p.theta_min.gain, p.theta_max.gain)
    return found


def params(changes: Values) -> dcarc.Params:
    """The law with these parameters at PERIOD."""
    values = {"controller": "dcarc", "sample_period": PERIOD, **changes}
    return dcarc.build(updated(CONTROLLER, defaults(CONTROLLER), values))


def shipped() -> dict[str, dcarc.Params]:
    """The law with its defaults, and with the gains of config/tuned. Raises ParameterError without them."""
    folder = ros_file.config_folder() / "tuned"
    found = {}
    for name, stems in SHIPPED.items():
        changes: Values = {}
        for stem in stems:
            changes |= files.load(str(folder / f"{stem}_dcarc.yaml"))["controller"]
        found[name] = params(changes)
    return found


class Task(NamedTuple):
    """Work for one process: one cell."""

    gains: str
    law: dcarc.Params
    box: str
    scale: float
    seed: int
    valves: int


def run_cell(task: Task) -> Cell:
    """Poles and bounds of one law on the valves of one box."""
    p = task.law
    law = feedback(p)
    valves = draw(task.seed, task.valves, task.box, task.scale)
    plants = sampled(valves)
    one = Valves(*(np.array([v]) for v in (1.0, 1.0, 1.0, 0.0, 0.0)))
    weight = learned_weight(p, valves.gain)
    learned = radii(law, plants, valves.gain * (1.0 + weight))
    worst = learned.copy()
    for tried in np.linspace(p.theta_min.gain, p.theta_max.gain, WEIGHTS):
        worst = np.maximum(worst, radii(law, plants, valves.gain * (1.0 + tried)))
    broken = learned >= 1.0
    rescued = {}
    for cause, nominal in zip(CAUSES, one, strict=True):
        healed = Valves(*(column[broken] for column in valves))
        healed = healed._replace(**{cause: np.full(int(np.sum(broken)), nominal[0])})
        saved = 0
        if np.any(broken):
            total = healed.gain * (1.0 + learned_weight(p, healed.gain))
            saved = int(np.sum(radii(law, sampled(healed), total) < 1.0))
        rescued[cause] = saved
    return Cell(
        gains=task.gains,
        box=task.box,
        scale=task.scale,
        initial=radii(law, plants, valves.gain * (1.0 + p.theta_initial.gain)),
        learned=learned,
        worst=worst,
        bound=small_gain(law, plants, valves.gain * (1.0 + weight), sampled(one)),
        teaching=np.where(broken, math.nan, teaching(law, plants, valves.gain * (1.0 + weight), p.lag_share)),
        rescued=rescued,
    )


def study(
    valves: int = 1000,
    seed: int = 1,
    scales: Sequence[float] = SCALES,
    laws: dict[str, dcarc.Params] | None = None,
    processes: int = 1,
    progress: Progress | None = None,
) -> Study:
    """Stability of dcarc on ``valves`` random valves of each box and scale.

    ``laws``: with their names; None: those that are shipped. ``progress(done, all)`` counts cells. Raises
    ParameterError if the shipped gains are not there.
    """
    chosen = shipped() if laws is None else laws
    tasks = [
        Task(name, p, box, scale, seed, valves)
        for name, p in chosen.items()
        for box in BOXES
        for scale in scales
    ]
    return Study(seed, valves, tuple(bench.work(run_cell, tasks, processes, progress)))
