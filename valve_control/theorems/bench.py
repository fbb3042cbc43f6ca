"""What the studies share: motions, the second-order plant of (17), its exact steps, work on all cores."""

import cmath
import math
import multiprocessing
import types
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import scipy.integrate

from valve_control.compiling import compile_function
from valve_control.laws import reshaping, velocity
from valve_control.laws.projection import Theta

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]
Task = TypeVar("Task")
Result = TypeVar("Result")

KEEPS_VELOCITY = velocity.Params(1.0, 0.0)  # a filter that gives back the velocity it was given
WIDE = 1e12  # V/s and V/s²; limits of a reshaping that never limits


def missing(*_: Any) -> Any:
    """Stands for a function of a law in a loop; replaced before the loop runs."""
    raise NotImplementedError


class Motion(NamedTuple):
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


def reference(m: Motion, time: float) -> tuple[float, float, float]:
    """x_vd [V] and its two derivatives [V/s, V/s²] at ``time`` [s]."""
    c1, s1 = math.cos(m.w1 * time), math.sin(m.w1 * time)
    c2, s2 = math.cos(m.w2 * time), math.sin(m.w2 * time)
    c3, s3 = math.cos(m.w3 * time), math.sin(m.w3 * time)
    return (
        m.start + m.a1 * (1.0 - c1) + m.a2 * (1.0 - c2) + m.a3 * (1.0 - c3),
        m.a1 * m.w1 * s1 + m.a2 * m.w2 * s2 + m.a3 * m.w3 * s3,
        m.a1 * m.w1 * m.w1 * c1 + m.a2 * m.w2 * m.w2 * c2 + m.a3 * m.w3 * m.w3 * c3,
    )


def command_for(p: reshaping.Params, position: float, rate: float, accel: float) -> float:
    """Command [V] for which (8) gives just this ``accel`` [V/s²]: the reshaping passes the motion on."""
    wn = p.natural_frequency
    return position + 2.0 * p.damping / wn * rate + accel / (wn * wn)


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


def loop_with(
    loop: Callable[..., Any], functions: Mapping[str, Callable[..., Any]], compiled: bool
) -> Callable[..., Any]:
    """``loop`` with its globals named in ``functions`` replaced, compiled or in plain Python."""
    if compiled:
        return compile_function(loop, {name: compile_function(f) for name, f in functions.items()})
    assert isinstance(loop, types.FunctionType)
    return types.FunctionType(loop.__code__, {**loop.__globals__, **functions}, loop.__name__)


def work(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int,
    progress: Progress | None = None,
) -> list[Result]:
    """Results of all ``tasks`` in their order, in ``jobs`` processes, or here if that is 1."""
    results: dict[int, Result] = {}

    def done(index: int, result: Result) -> None:
        results[index] = result
        if progress is not None:
            progress(len(results), len(tasks))

    if jobs <= 1:
        for i, task in enumerate(tasks):
            done(i, function(task))
    else:
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
            numbers: dict[Any, int] = {pool.submit(function, task): i for i, task in enumerate(tasks)}
            for future in as_completed(numbers):
                done(numbers[future], future.result())
    return [results[i] for i in range(len(tasks))]
