# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Fits a valve with solenoids to the tests: coil, hysteresis, two gains, overlap and LuGre friction.

Like the fit of ``plant``, which has a linear valve with friction, this is an output error fit: the simulated
valve (``solenoid``, docs/explanation/valve_model.md) gets the voltages of the tests.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.optimize

from valve_control.arrays import Floats
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant.models import TransferFunction
from valve_control.design.commissioning.evaluation import Friction
from valve_control.parameter import Values, defaults

STRIBECK = 0.03  # V/s  which the tests do not show
PRESLIDING, SHORTEST, LONGEST = 0.02, 0.002, 0.15  # V  first guess and bounds
WIDTH = 0.3  # of the friction, full width of the hysteresis with which a search begins
FASTEST_COIL, SLOWEST_COIL = 3e-4, 0.03  # s
AT_BOUND = 1.1  # times the fastest coil, up to which there is none
COIL = 0.2  # of the spool's time constant, where a response shows no third pole
STUCK = 1e-3  # V  least friction
MOST_RATIO = 2.0  # -  static over Coulomb friction
WIDEST = 2.0  # V  hysteresis and overlap
LONGEST_DELAY = 0.005  # s
SIDES = 0.5  # logarithm of the ratio of both gains
EVALUATIONS = 80  # of a search, at most, each with a Jacobian
CONVERGED = 1e-3  # relative change of the cost in one evaluation, below which a search ends
STEP = 2e-3  # of an unknown, for the Jacobian
INSIDE = 1e-3  # of the bounds, within which a search begins


class Magnet(NamedTuple):
    """A valve with two solenoids."""

    speed: float  # rad/s  natural frequency of the spool
    damping: float  # -
    coil: float  # s
    gain: float  # V/V  mean of both sides
    sides: float  # -  logarithm of the ratio of the positive gain to the negative
    hysteresis: float  # V  full width
    overlap: float  # V
    coulomb: float  # V
    presliding: float  # V
    static_ratio: float  # -
    offset: float  # V
    delay: float  # s

    @property
    def positive(self) -> float:
        """Factor of the gain of the positive side; that of the other one makes their mean 1."""
        return 2.0 / (1.0 + math.exp(-self.sides))

    @property
    def negative(self) -> float:
        """Factor of the gain of the negative side."""
        return 2.0 - self.positive

    @property
    def model(self) -> TransferFunction:
        """From voltage to position, for small motions."""
        return build.valve_model({**defaults(VALVE), **values(self, 0.0)})


def values(m: Magnet, sensor_delay: float) -> Values:
    """``m`` as parameters of the simulated valve.

    ``sensor_delay`` [s]: what of the dead time is the LVDT's.
    """
    behind = min(m.delay, sensor_delay)
    parameters = {
        "solenoid.natural_frequency": m.speed / (2.0 * math.pi),
        "solenoid.damping": m.damping,
        "solenoid.coil": m.coil,
        "solenoid.gain": m.gain,
        "solenoid.positive": m.positive,
        "solenoid.negative": m.negative,
        "solenoid.hysteresis": m.hysteresis,
        "solenoid.overlap": m.overlap,
        "solenoid.dead_time": m.delay - behind,
        "lvdt.delay": behind,
        "friction.coulomb": m.coulomb,
        "friction.static_ratio": m.static_ratio,
        "friction.stribeck_velocity": STRIBECK,
        "friction.presliding": m.presliding,
        "disturbance.offset": max(-10.0, min(10.0, m.offset)),
    }
    return {"valve": "solenoid", **{name: float(f"{value:.6g}") for name, value in parameters.items()}}


def first_guess(model: TransferFunction, friction: Friction, offset: float, delay: float) -> Magnet:
    """Where a search begins: a fitted ``model``, its ``delay`` [s] and ``offset`` [V] as a disturbance.

    The spool is the pair of poles; of three real ones the slower two.
    """
    poles = sorted(np.roots(model.denominator), key=lambda pole: (abs(pole), pole.imag))
    slow = [pole for pole in poles if pole.imag != 0.0][:2] or poles[:2]
    speed = math.sqrt(abs(slow[0] * slow[1]))
    damping = float(-np.real(slow[0] + slow[1])) / (2.0 * speed)
    others = [pole.real for pole in poles if pole not in slow and pole.imag == 0.0]
    coulomb = max(STUCK, friction.coulomb)
    return Magnet(
        speed=speed,
        damping=min(3.0, max(0.1, damping)),
        coil=-1.0 / others[0] if others and others[0] < 0.0 else COIL / speed,
        gain=model.static_gain,
        sides=0.0,
        hysteresis=WIDTH * coulomb,
        overlap=0.0,
        coulomb=(1.0 - 0.5 * WIDTH) * coulomb,
        presliding=PRESLIDING,
        static_ratio=min(MOST_RATIO, friction.static_ratio),
        offset=offset,
        delay=delay,
    )


# In the order of ``Magnet``: bounds of each number, and what is added to it (or to its logarithm) so that the
# unknown of a search is of the size of 1. Bounds of RELATIVE are factors of what the search begins with.
LOW = np.array([0.3, 0.05, FASTEST_COIL, 0.3, -SIDES, 0.0, -WIDEST, STUCK, SHORTEST, 1.0, -9.0, 0.0])
HIGH = np.array(
    [5.0, 4.0, SLOWEST_COIL, 3.0, SIDES, WIDEST, WIDEST, 9.0, LONGEST, MOST_RATIO, 9.0, LONGEST_DELAY]
)
SHIFT = np.array([1.0, 2.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 0.0, 1.0, 1.0])
UNITS = np.array([1.0, 1.0, 1e-3, 1.0, 1.0, 1.0, 1.0, 1.0, PRESLIDING, 1.0, 1.0])  # of all but the delay
RELATIVE = np.isin(Magnet._fields, ("speed", "gain"))
LOGARITHMIC = np.isin(Magnet._fields, ("speed", "damping", "coil", "presliding"))


def unknowns(m: Floats | Magnet, period: float) -> Floats:
    """``m`` as unknowns of a search, all of the size of 1; its delay is counted in periods."""
    scaled = np.array(m) / np.append(UNITS, period)
    return SHIFT + np.where(LOGARITHMIC, np.log(np.where(LOGARITHMIC, scaled, 1.0)), scaled)


def of_unknowns(x: Floats, period: float) -> Magnet:
    """The valve of ``unknowns``."""
    moved = x - SHIFT
    numbers = np.where(LOGARITHMIC, np.exp(np.where(LOGARITHMIC, moved, 0.0)), moved)
    return Magnet(*(numbers * np.append(UNITS, period)).tolist())


def refined(
    begin: Magnet,
    period: float,
    errors: Callable[[Magnet], Floats],
    tell: Callable[[], None] = lambda: None,
) -> Magnet:
    """The valve near ``begin`` whose ``errors``, over what is allowed, are least.

    ``tell`` is called before each simulation.
    """
    factors = np.where(RELATIVE, np.array(begin), 1.0)
    low, high = (unknowns(bound * factors, period) for bound in (LOW, HIGH))
    inside = np.clip(unknowns(begin, period), low + INSIDE * (high - low), high - INSIDE * (high - low))

    def residual(x: Floats) -> Floats:
        tell()
        return errors(of_unknowns(x, period))

    done = scipy.optimize.least_squares(
        residual, inside, bounds=(low, high), diff_step=STEP, x_scale="jac", loss="soft_l1",
        max_nfev=EVALUATIONS, ftol=CONVERGED,
    )  # fmt: skip
    return of_unknowns(done.x, period)
