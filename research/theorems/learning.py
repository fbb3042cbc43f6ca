# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lets dcarc learn at several speeds on random valves: whether slow learning helps, where fast one harms.

The valves are those of the wide box of ``loop``, first without friction and noise, then with both. The
reference has three sines; the reshaping passes it on exactly. Each valve is also run without learning, which
the error with it is compared with. The voltage of the compensation is compared with the bound that projection
gives it.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from research.theorems import bench, loop
from research.theorems.bench import Array, CosineReference, Progress
from valve_control.control import closed_loop
from valve_control.control.laws import dcarc, least_squares, reshaping
from valve_control.control.laws.signals import Start
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL

DURATION = 8.0  # s
WINDOW = 0.5  # s; the motion repeats itself in it
U_MAX = 100.0  # V; nothing is promised in saturation
CYCLE = 1.0  # V  error of a loop that has left its motion
W = 2.0 * np.pi
MOTION = CosineReference(-1.05, 0.5, 2.0 * W, 0.3, 6.0 * W, 0.25, 14.0 * W)
NOISES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # of fit_noise over the shipped one; less is faster
WORSE = 1.05  # error with learning over that without
KINDS = ("linear", "friction")


class Cell(NamedTuple):
    """All valves of one kind at one speed of learning."""

    kind: str
    noise: float  # -  fit_noise over the shipped one
    first: Array  # V  rms error of each valve in the second window
    last: Array  # V  in the last one
    resting: Array  # V  in the last one, without learning
    compensation: Array  # -  largest |u_c| over its bound

    @property
    def ratio(self) -> Array:
        """Error in the last window over that without learning."""
        return self.last / self.resting

    @property
    def worse(self) -> int:
        """Valves on which learning does harm."""
        return int(np.sum(~(self.ratio <= WORSE)))

    @property
    def lost(self) -> int:
        """Valves whose loop has left its motion."""
        return int(np.sum(~(self.last < CYCLE)))


class Experiment(NamedTuple):
    """Results for all kinds of valves and speeds."""

    seed: int
    valves: int
    duration: float  # s
    cells: tuple[Cell, ...]

    def cell(self, kind: str, noise: float) -> Cell:
        """Results of one combination."""
        return next(c for c in self.cells if (c.kind, c.noise) == (kind, noise))


def plants(kind: str, seed: int, count: int) -> list[valve.Params]:
    """Valves of the wide box, with dead time and offset; without friction and noise if ``kind`` is linear."""
    box = loop.draw(seed, count, "wide", 1.0)
    random = np.random.default_rng([seed, 1])
    made = []
    for i in range(count):
        offset, coulomb = random.uniform(-0.5, 0.5), random.uniform(0.0, 1.6)
        static, presliding = random.uniform(1.0, 1.6), random.uniform(0.01, 0.04)
        rough = kind == "friction"
        disturbance = valve.NO_DISTURBANCE._replace(
            coulomb=float(coulomb) if rough else 0.0,
            static_ratio=float(static),
            stribeck_velocity=0.017,
            velocity_scale=0.02,
            presliding=float(presliding),
            flow_force=float(box.flow[i]),
            offset=float(offset),
        )
        lvdt = IDEAL._replace(delay=float(box.delay[i]) / loop.PERIOD)
        if rough:
            lvdt = lvdt._replace(noise=0.0056, resolution=0.0037)
        model = loop.model(float(box.poles[i]), float(box.zeros[i]))
        made.append(valve.design(model, loop.PERIOD, U_MAX, float(box.gain[i]), disturbance, lvdt))
    return made


def commands(p: reshaping.Params, samples: int) -> tuple[Array, float]:
    """Commands [V] under which the steps (11) go through the motion, and the rate [V/s] to begin with."""
    position = np.array([bench.reference(MOTION, k * p.period)[0] for k in range(samples + 2)])
    rate = np.diff(position) / p.period
    accel = np.diff(rate) / p.period
    return bench.command_for(p, position[:-2], rate[:-1], accel), float(rate[0])


def largest(p: float, most: float, now: closed_loop.Sample, spool: valve.State) -> tuple[float, bool]:
    """Keep the largest voltage of the compensation."""
    return max(most, abs(now.terms.compensation_voltage)), False


def shown(spool: valve.State, now: closed_loop.Sample) -> tuple[float]:
    """True error [V]."""
    return (spool.x.x0 - now.terms.reference,)


def compensation_bound(p: dcarc.Params, position: float, rate: float, accel: float) -> float:
    """Largest |u_c| [V] that projection allows of a reference within these limits [V, V/s, V/s²].

    The inverse's inner states are bounded by the sum of the magnitudes of its impulse response.
    """
    inner, given = np.hsplit(np.array(p.full), [4])  # what ζ and its derivatives of now, and r, lead to
    pushed = np.abs(given) @ [position, rate]
    peak, power = np.zeros(len(inner)), np.eye(len(inner))
    while np.max(np.abs(power) @ pushed) > 1e-9 * np.max(peak + pushed):
        peak += np.abs(power) @ pushed
        power = inner @ power
    half = np.abs(np.array(p.half)) @ [*peak, position, rate]
    voltage = float(np.abs(np.array(p.model_voltage)) @ [*half, position, rate, accel, 0.0])
    most = least_squares.Weights(voltage, 1.0, 1.0, 1.0, 1.0, position, 1.0, rate, accel)
    span = np.maximum(np.abs(p.theta_min), np.abs(p.theta_max))
    return float(span @ most)


def limits(motion: CosineReference) -> tuple[float, float, float]:
    """Largest |x_vd| [V], rate [V/s] and acceleration [V/s²] of a motion, at most."""
    sizes = np.abs([motion.a1, motion.a2, motion.a3])
    speeds = np.array([motion.w1, motion.w2, motion.w3])
    position = max(abs(motion.start), abs(motion.start + 2.0 * float(np.sum(sizes))))
    return position, float(sizes @ speeds), float(sizes @ speeds**2)


class Task(NamedTuple):
    """Work for one process: all valves of one cell."""

    kind: str
    noise: float
    seed: int
    valves: int
    duration: float  # s


@functools.cache
def _loop() -> Any:
    return closed_loop.build(
        {
            "next_command": closed_loop.command_given,
            "read": valve.read,
            "law_step": dcarc.step,
            "measured": largest,
            "plant_step": valve.step,
            "shown": shown,
        }
    )


def run_valve(p: dcarc.Params, plant: valve.Params, seed: int, samples: int) -> tuple[Array, float]:
    """True error [V] at each sample from rest on, and the largest |u_c| [V]."""
    rest = MOTION.start
    spool = valve.initial(plant)
    column = np.linalg.solve(np.eye(4) - np.array(plant[:4]), np.array(plant.input))
    spool = spool._replace(x=valve.Row(*(float(v) for v in column * rest / column[0])))
    spool.history[:] = rest
    given, rate = commands(p.reshaping, samples)
    law = dcarc.initial(p, Start(rest, _holding(plant, rest / float(column[0]), rest), rest, rate, 0.0))
    parts, begin = closed_loop.parts(p, plant), closed_loop.parts(law, spool)
    noise = np.random.default_rng(seed).standard_normal(samples)
    errors = np.zeros((samples, 1))
    end = _loop()(parts, begin, given, noise, errors, np.zeros((0, 1)))
    return errors[:, 0], float(end.measure)


def _holding(plant: valve.Params, push: float, position: float) -> float:
    """Voltage [V] that holds the spool where the model needs ``push`` [V], without friction."""
    d = plant.disturbance
    return push / plant.gain_scale - d.offset + d.flow_force * position


def run_cell(task: Task) -> Cell:
    """Run all valves of one cell, with learning and without."""
    base = loop.params({"u_max": U_MAX})._replace(reshaping=bench.unlimited(loop.PERIOD))
    learns = base._replace(fit_variance=base.fit_variance * task.noise**2)
    rests = base._replace(prior=least_squares.NOTHING)
    window, samples = round(WINDOW / loop.PERIOD), round(task.duration / loop.PERIOD)
    bound = compensation_bound(base, *limits(MOTION))
    rows = []
    for i, plant in enumerate(plants(task.kind, task.seed, task.valves)):
        error, most = run_valve(learns, plant, i, samples)
        other, _ = run_valve(rests, plant, i, samples)
        early = error[window : 2 * window]
        rows.append(
            [*(np.sqrt(np.mean(e**2)) for e in (early, error[-window:], other[-window:])), most / bound]
        )
    return Cell(task.kind, task.noise, *np.array(rows).T)


def experiment(
    valves: int = 100,
    seed: int = 1,
    noises: Sequence[float] = NOISES,
    duration: float = DURATION,
    processes: int = 1,
    progress: Progress | None = None,
) -> Experiment:
    """Let dcarc learn on ``valves`` random valves of each kind, at each speed.

    ``progress(done, all)`` counts cells.
    """
    tasks = [Task(kind, noise, seed, valves, duration) for kind in KINDS for noise in noises]
    if processes > 1:
        run_cell(tasks[0]._replace(valves=1, duration=2.0 * WINDOW))  # fills numba's cache
    return Experiment(seed, valves, duration, tuple(bench.work(run_cell, tasks, processes, progress)))
