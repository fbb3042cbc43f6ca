# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Holds what the experiments share: motions, exact steps of the plant (17), work on all cores."""

import cmath
import math
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import scipy.integrate

from research import running
from valve_control.control import closed_loop
from valve_control.control.compiling import bind, compile_function
from valve_control.control.laws import reshaping, velocity
from valve_control.control.laws.projection import Theta

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]
Task = TypeVar("Task")
Result = TypeVar("Result")

KEEPS_VELOCITY = velocity.Params(1.0, 0.0)  # a filter that gives back the velocity it was given
WIDE = 1e12  # V/s and V/s²; limits of a reshaping that never limits


def missing(*_: Any) -> Any:
    """Placeholder for a law's function in a loop; replaced before the loop runs."""
    raise NotImplementedError


class CosineReference(NamedTuple):
    """Reference x_vd = start + Σ aᵢ·(1 - cos(wᵢ·t)): known with all its derivatives, at rest at t = 0."""

    start: float  # V
    a1: float  # V
    w1: float  # rad/s
    a2: float  # V
    w2: float  # rad/s
    a3: float  # V
    w3: float  # rad/s


class Plant(NamedTuple):
    """Exact step of ẍ + a1·ẋ + a0·x = force [V/s²] with the force held."""

    m11: float
    m12: float
    m21: float
    m22: float
    g1: float
    g2: float


def reference(m: CosineReference, time: float) -> tuple[float, float, float]:
    """x_vd [V] and its two derivatives [V/s, V/s²] at ``time`` [s]."""
    c1, s1 = math.cos(m.w1 * time), math.sin(m.w1 * time)
    c2, s2 = math.cos(m.w2 * time), math.sin(m.w2 * time)
    c3, s3 = math.cos(m.w3 * time), math.sin(m.w3 * time)
    return (
        m.start + m.a1 * (1.0 - c1) + m.a2 * (1.0 - c2) + m.a3 * (1.0 - c3),
        m.a1 * m.w1 * s1 + m.a2 * m.w2 * s2 + m.a3 * m.w3 * s3,
        m.a1 * m.w1 * m.w1 * c1 + m.a2 * m.w2 * m.w2 * c2 + m.a3 * m.w3 * m.w3 * c3,
    )


def command_for(p: reshaping.Params, position: Any, rate: Any, accel: Any) -> Any:
    """Command [V] for which (8) gives just this ``accel`` [V/s²]: the reshaping passes the motion on.

    Numbers, or arrays with an entry per sample.
    """
    wn = p.natural_frequency
    return position + 2.0 * p.damping / wn * rate + accel / (wn * wn)


class Course(NamedTuple):
    """A motion in the form of a command source, for a law with this reshaping."""

    motion: CosineReference
    reshaping: reshaping.Params
    period: float  # s


class Wanted(NamedTuple):
    """Reference at one sample, and the command that brings the law's reference there."""

    time: float  # s
    position: float  # V
    rate: float  # V/s
    command: float  # V


class Spool(NamedTuple):
    """State of the second-order valve."""

    x1: float  # V
    x2: float  # V/s


def course(p: Course, state: float, number: float) -> tuple[Wanted, float]:
    """Command source: the command of sample ``number``."""
    time = number * p.period
    position, rate, accel = reference(p.motion, time)
    return Wanted(time, position, rate, command_for(p.reshaping, position, rate, accel)), state


def read(p: Any, s: Spool, noise: float) -> Spool:
    """Sensors that show position and velocity without error."""
    return s


def moved(p: Plant, s: Spool, force: float) -> Spool:
    """State of the valve after one step with ``force`` [V/s²] held over it."""
    return Spool(p.m11 * s.x1 + p.m12 * s.x2 + p.g1 * force, p.m21 * s.x1 + p.m22 * s.x2 + p.g2 * force)


def unlimited(period: float) -> reshaping.Params:
    """Reshaping without limits, sampled every ``period`` [s]."""
    return reshaping.Params(314.0, 0.8, WIDE, WIDE, period)


def plant(truth: Theta, period: float) -> Plant:
    """Plant with the parameters ``truth``, discretised exactly at ``period`` [s]."""
    s = 0.5 * truth.a1
    w = cmath.sqrt(truth.a0 - s * s)
    decay = math.exp(-s * period)
    c = decay * cmath.cos(w * period).real
    d = decay * (cmath.sin(w * period) / w).real if w != 0.0 else decay * period
    m11 = c + s * d
    return Plant(m11, d, -truth.a0 * d, c - s * d, (1.0 - m11) / truth.a0, d)


def observer_peak(k1: float, k2: float) -> float:
    """Largest |ε_u,2| [V/s] of (33) that |d̃| <= 1 V/s² can cause: ∫|e2ᵀ·exp(A0·t)·e2|dt."""
    s = 0.5 * k1
    w = np.sqrt(complex(k2 - s * s))
    slowest = s - abs(w.imag)
    t = np.linspace(0.0, 30.0 / slowest, 300_001)
    response = np.exp(-s * t) * (np.cos(w * t) + s * np.sin(w * t) / w).real
    return float(scipy.integrate.trapezoid(np.abs(response), t))


def order(x: Array, y: Array) -> float:
    """Exponent p of y ~ xᵖ, least squares on logarithms; NaN with fewer than two points."""
    if len(x) < 2:
        return math.nan
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def quantile(values: Array, share: float) -> float:
    """Quantile of the finite entries; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if len(known) else math.nan


def loop_with(
    loop: Callable[..., Any], functions: Mapping[str, Callable[..., Any]], compiled: bool
) -> Callable[..., Any]:
    """``loop`` with its globals named in ``functions`` replaced, compiled or in plain Python."""
    if compiled:
        return compile_function(loop, {name: compile_function(f) for name, f in functions.items()})
    bound: Callable[..., Any] = bind({"": loop}, functions)[""]
    return bound


def loop_on_motion(
    law_step: Callable[..., Any],
    measured: Callable[..., Any],
    plant_step: Callable[..., Any],
    shown: Callable[..., Any],
    compiled: bool,
) -> Callable[..., Any]:
    """The closed loop on a ``Course``, made of these functions, with a valve that is read without error."""
    functions: dict[str, Callable[..., Any]] = {
        "next_command": course,
        "read": read,
        "law_step": law_step,
        "measured": measured,
        "plant_step": plant_step,
        "shown": shown,
    }
    return closed_loop.build(functions, compiled)


def work(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    processes: int,
    progress: Progress | None = None,
) -> list[Result]:
    """Results of all ``tasks`` in their order, computed in ``processes`` processes, or here if that is 1."""
    results: dict[int, Result] = {}

    def done(index: int, result: Result) -> None:
        results[index] = result
        if progress is not None:
            progress(len(results), len(tasks))

    if processes <= 1:
        for i, task in enumerate(tasks):
            done(i, function(task))
    else:
        with running.pool(processes, multiprocessing.get_context("spawn")) as pool:
            numbers: dict[Any, int] = {pool.submit(function, task): i for i, task in enumerate(tasks)}
            for future in as_completed(numbers):
                done(numbers[future], future.result())
    return [results[i] for i in range(len(tasks))]
