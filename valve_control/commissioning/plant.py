"""Fits the valve with its friction to the tests: the simulated valve gets the same voltages (output error).

The response without friction is where the search begins. At low frequencies the spool sticks at each turn,
which no response shows; simulated, it does the same.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.optimize

from valve_control import closed_loop
from valve_control.commissioning.bench import Record
from valve_control.commissioning.statics import Friction, Rest
from valve_control.identification.rational import Fit
from valve_control.laws import biquads, design
from valve_control.laws.signals import Start
from valve_control.parameter import Values
from valve_control.plant import valve
from valve_control.plant.models import TransferFunction

Floats = npt.NDArray[np.float64]
MODEL_ERROR = 0.03  # of a stretch's motion, that a model of the valve is allowed beside the noise
QUIET = 1e-3  # V  noise that is assumed at least
STRETCH = 0.8  # s  over which motion and noise are weighed against each other
EVALUATIONS = 14  # of the search, each with a Jacobian
STEP = 2e-3  # of a parameter's unit, for the Jacobian
FREE_VELOCITY, SCALE = 0.1, 0.02  # V/s  Stribeck velocity and linear zone, which the tests do not show
BETTER = 0.97  # times the error of the second order, below which a fourth order counts
LATEST = 5.0  # sample periods of dead time


class Plant(NamedTuple):
    """A valve with friction, dead time and offset."""

    model: TransferFunction
    friction: Friction
    offset: float  # V  input disturbance
    delay: float  # s
    error: float  # rms of the residual over what is allowed


def values(found: Plant, rest: Rest, period: float, u_max: float) -> Values:
    """``found`` as parameters of the simulated valve."""
    numerator, denominator = ([float(f"{c:.10g}") for c in part] for part in found.model)
    made: Values = {
        "valve": "custom",
        "numerator": numerator,
        "denominator": denominator,
        "gain_scale": 1.0,
        "flow_force": 0.0,
        "sample_period": period,
        "u_max": u_max,
        "friction.coulomb": float(f"{found.friction.coulomb:.6g}"),
        "friction.static_ratio": float(f"{found.friction.static_ratio:.6g}"),
        "disturbance.offset": max(-10.0, min(10.0, float(f"{found.offset:.6g}"))),
        "lvdt.noise": rest.noise,
        "lvdt.resolution": rest.resolution,
        "lvdt.delay": float(f"{found.delay:.6g}"),
    }
    return made


def fitted(
    records: Sequence[Record], fits: Sequence[Fit], friction: Friction, offset: float, rest: Rest
) -> Plant:
    """The valve whose simulation comes nearest to ``records``, of the order of one of ``fits``."""
    weights = [_weight(record, rest) for record in records]
    best: Plant | None = None
    for fit in sorted(fits, key=lambda f: f.order):
        made = _refined(records, weights, fit, friction, offset)
        if best is None or made.error < BETTER * best.error:
            best = made
    assert best is not None
    return best


def simulated(found: Plant, record: Record) -> Floats:
    """Position [V], n, of the valve under the voltages of ``record``."""
    disturbance = valve.Disturbance(
        found.friction.coulomb,
        found.friction.static_ratio,
        FREE_VELOCITY,
        SCALE,
        0.0,
        0.0,
        found.offset,
        0.0,
        0.0,
    )
    lvdt = valve.Lvdt(0.0, 0.0, 0.0, found.delay / record.period)
    plant = valve.design(found.model, record.period, 1e6, 1.0, disturbance, lvdt)
    return positions(plant, record.voltage)


def positions(plant: valve.Params, voltage: Floats) -> Floats:
    """Readings [V] without noise, n, of ``plant`` under ``voltage`` [V], from rest at 0 V."""
    law = design.static_params(1.0, plant.u_max)
    rest = biquads.initial(law, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    n = len(voltage)
    signals = np.zeros((n, len(closed_loop.SIGNALS)))
    closed_loop.run_valve(
        biquads,
        closed_loop.parts(law, plant),
        closed_loop.parts(rest, valve.initial(plant)),
        voltage,
        np.zeros(n),
        signals,
        np.zeros((0, len(biquads.Terms._fields))),
    )
    return signals[:, 1]


def _weight(record: Record, rest: Rest) -> Floats:
    """One over the error that is allowed at each sample; 0.0 where a reading was lost."""
    length = max(1, round(STRETCH / record.period))
    noise = math.hypot(max(QUIET, rest.noise), rest.resolution / math.sqrt(12.0))
    weight = np.zeros(len(record.reading))
    for first in range(0, len(weight), length):
        part = record.reading[first : first + length]
        known = np.isfinite(part)
        if np.any(known):
            moved = float(np.std(part[known]))
            weight[first : first + length] = known / math.hypot(noise, MODEL_ERROR * moved)
    return weight


def _refined(
    records: Sequence[Record], weights: Sequence[Floats], fit: Fit, friction: Friction, offset: float
) -> Plant:
    period = records[0].period
    begin = _parameters(fit, friction, offset, period)
    zeros = len(fit.model.numerator)

    def residual(x: Floats) -> Floats:
        plant = _plant(x, fit.order, zeros, friction.static_ratio, period)
        with np.errstate(over="ignore", invalid="ignore"):
            parts = [
                np.where(w > 0.0, w * (simulated(plant, r) - np.nan_to_num(r.reading)), 0.0)
                for r, w in zip(records, weights, strict=True)
            ]
        found: Floats = np.clip(np.nan_to_num(np.concatenate(parts), nan=1e3), -1e3, 1e3)
        return found

    lower, upper = np.full(len(begin), -np.inf), np.full(len(begin), np.inf)
    lower[-3:], upper[-3:] = (0.0, -np.inf, 0.0), (np.inf, np.inf, LATEST)
    begin[-3], begin[-1] = max(begin[-3], 1e-6), min(max(begin[-1], 1e-3), LATEST - 1e-3)
    done = scipy.optimize.least_squares(
        residual, begin, bounds=(lower, upper), diff_step=STEP, x_scale="jac", loss="soft_l1",
        max_nfev=EVALUATIONS,
    )  # fmt: skip
    plant = _plant(done.x, fit.order, zeros, friction.static_ratio, period)
    return plant._replace(error=float(np.sqrt(np.mean(residual(done.x) ** 2))))


def _parameters(fit: Fit, friction: Friction, offset: float, period: float) -> Floats:
    """Logarithms of the denominator's quadratics, numerator over its static part, friction, offset, delay."""
    roots = np.roots(fit.model.denominator)
    ordered = sorted(roots, key=lambda root: (abs(root), root.imag))
    factors = []
    for i in range(0, len(ordered), 2):
        pair = np.poly(ordered[i : i + 2]).real
        factors += [1.0 + math.log(pair[1]), 1.0 + math.log(pair[2])]
    scale = abs(fit.model.denominator[-1]) ** (1.0 / fit.order)
    static = fit.model.denominator[-1]
    ascending = [c * scale**i / static for i, c in enumerate(reversed(fit.model.numerator))]
    return np.array([*factors, *ascending, friction.coulomb, offset, fit.delay / period])


def _plant(x: Floats, order: int, zeros: int, static_ratio: float, period: float) -> Plant:
    denominator: npt.NDArray[Any] = np.ones(1)
    for i in range(order // 2):
        denominator = np.polymul(denominator, [1.0, math.exp(x[2 * i] - 1.0), math.exp(x[2 * i + 1] - 1.0)])
    scale = denominator[-1] ** (1.0 / order)
    ascending = [x[order + i] * denominator[-1] * scale**-i for i in range(zeros)]
    model = TransferFunction(tuple(map(float, ascending[::-1])), tuple(map(float, denominator)))
    friction = Friction(max(0.0, float(x[-3])), static_ratio)
    return Plant(model, friction, -float(x[-2]), float(x[-1]) * period, math.inf)
