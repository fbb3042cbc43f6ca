# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Fits the valve with its friction to the tests: the simulated valve gets the same voltages (output error).

The response without friction is where the search begins. At low frequencies the spool sticks at each turn,
which no response shows; simulated, it does the same. A valve with solenoids has coil, hysteresis, two gains,
overlap and LuGre friction (docs/explanation/valve_model.md).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize

from valve_control.arrays import Floats
from valve_control.control import closed_loop
from valve_control.control.laws import biquads
from valve_control.control.laws.signals import Start
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import registry
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.commissioning.bench import Record
from valve_control.design.commissioning.evaluation import Friction, Rest
from valve_control.design.identification import bode_fit
from valve_control.design.identification.characteristic import TOLD_OVERLAP
from valve_control.parameter import ParameterError, Values, defaults

MODEL_ERROR = 0.03  # of a stretch's motion, that a model of the valve is allowed beside the noise
QUIET = 1e-3  # V  noise that is assumed at least
STRETCH = 0.8  # s  over which motion and noise are weighed against each other
EVALUATIONS = 14  # of the search, each with a Jacobian
STEP = 2e-3  # of a parameter's unit, for the Jacobian
BEGINNING = 0.005  # s  of a test, whose mean reading is where the spool stands at first
WITHOUT_END = 1e6  # V
BETTER = 0.97  # times the error of the order below, under which a higher order counts
LATEST, LATEST_TIME = 5.0, 0.01  # sample periods and s, the larger of which bounds the dead time
EXPLAINED = 3.0  # error up to which a model describes the valve
SUSPECT = 0.75  # error from which on a valve with solenoids is tried
AS_GOOD = 1.05  # times the error of the valve with solenoids, up to which a linear one stands for it
SIMPLER = 0.8  # times the error of the linear valve, under which that with solenoids counts
FIRST_POLE = 0.45  # of the bound, the fastest pole of a search at first: a coefficient may be a sum of two
AWAY = 0.1  # of the logarithms of coefficients, from their bounds, where a search begins
# Of a pole beyond these nothing but its lag shows, and a search would go on with it to infinity: the tests
# end at 100 Hz or below, and at a fifth of the sampling frequency.
SLOWEST_POLE = 0.01  # rad/s
FASTEST_POLE, FASTEST_SPEED = 10.0, 6000.0  # radians a sample and rad/s, the smaller of which bounds it
# Of a valve with solenoids
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
MOST_EVALUATIONS = 80  # of a search with solenoids, each with a Jacobian
CONVERGED = 1e-3  # relative change of the cost in one evaluation, below which a search ends
INSIDE = 1e-3  # of the bounds, within which a search begins
NO_STOPS: Values = {"solenoid.stop_low": -1000.0, "solenoid.stop_high": 1000.0}  # V  the tests show none


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
        return build.valve_model({**defaults(VALVE), **solenoid_values(self, 0.0)})


class Plant(NamedTuple):
    """A valve with friction, dead time and offset."""

    model: TransferFunction
    friction: Friction
    offset: float  # V  input disturbance
    delay: float  # s
    error: float  # rms of the residual over what is allowed
    presliding: float = 0.0  # V  of the friction's bristles; 0.0: none, which the tests do not contradict
    magnet: Magnet | None = None  # a valve with solenoids, of which the others are a part; None: linear

    @property
    def hysteresis(self) -> float:
        """Width [V] of the loop of position over slowly changed voltage, mean of both sides."""
        return 2.0 * self.friction.coulomb + (0.0 if self.magnet is None else self.magnet.hysteresis)


def values(fitted: Plant, rest: Rest, period: float, u_max: float, sensor_delay: float = 0.0) -> Values:
    """The ``fitted`` valve as parameters of the simulated one.

    ``sensor_delay`` [s]: what of the dead time of a valve with solenoids is the sensor's.
    """
    common: Values = {
        "sample_period": period,
        "u_max": u_max,
        "lvdt.noise": rest.noise,
        "lvdt.resolution": rest.resolution,
        "gain_scale": 1.0,
        "flow_force": 0.0,
    }
    if fitted.magnet is not None:
        of_valve = solenoid_values(fitted.magnet, sensor_delay)
        return {**of_valve, **common, **NO_STOPS, "solenoid.u_min": -u_max}
    numerator, denominator = ([float(f"{c:.10g}") for c in part] for part in fitted.model)
    return {
        "valve": "custom",
        "numerator": numerator,
        "denominator": denominator,
        **common,
        "friction.coulomb": float(f"{fitted.friction.coulomb:.6g}"),
        "friction.static_ratio": float(f"{fitted.friction.static_ratio:.6g}"),
        "friction.presliding": float(f"{fitted.presliding:.6g}"),
        "disturbance.offset": max(-10.0, min(10.0, float(f"{fitted.offset:.6g}"))),
        "lvdt.delay": float(f"{fitted.delay:.6g}"),
    }


def solenoid_values(m: Magnet, sensor_delay: float) -> Values:
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


def fitted(
    records: Sequence[Record],
    fits: Sequence[bode_fit.Fit],
    friction: Friction,
    offset: float,
    rest: Rest,
    tell: Callable[[], None] = lambda: None,
    richer: Callable[[], Sequence[bode_fit.Fit]] = tuple,
) -> Plant:
    """The valve whose simulation comes nearest to ``records``, of the order of one of ``fits``.

    ``friction`` and ``offset`` [V] are first guesses. Where none explains the readings, the forms of
    ``richer`` are tried too, and a valve with solenoids. ``tell`` is called before each simulation; what it
    raises ends the search.
    """
    ordered = sorted(fits, key=lambda f: f.order)
    tests = _Tests(records, [_weight(record, rest) for record in records], tell)
    best = _best([_near(tests, fit, friction, offset) for fit in ordered])
    if best.error > EXPLAINED:
        best = _best([best, *(_near(tests, fit, friction, offset) for fit in richer())])
    if friction.coulomb > 0.0 and best.error > SUSPECT:
        return _with_solenoids(tests, fits, best, friction, offset)
    return best


def _best(plants: Sequence[Plant]) -> Plant:
    """The first of ``plants``, or a later one whose error is less by more than rounding."""
    best, *others = plants
    for plant in others:
        if plant.error < BETTER * best.error:
            best = plant
    return best


def simulated(plant: Plant, record: Record) -> Floats:
    """Position [V], n, of the valve under the voltages of ``record``.

    Each part begins where its spool stands first.
    """
    valve_params = params(plant, record.period)
    return np.concatenate(
        [
            positions(valve_params, part.voltage, first_reading(part.reading, part.period))
            for part in record.parts()
        ]
    )


def params(plant: Plant, period: float) -> Any:
    """``plant`` as a simulated valve without noise and limits."""
    return build.valve_params({**defaults(VALVE), **values(plant, Rest(0.0, 0.0, 0.0), period, WITHOUT_END)})


def first_reading(reading: Floats, period: float) -> float | None:
    """Mean [V] of the ``reading`` [V], n, in the BEGINNING of a test; None: none came."""
    known = reading[: max(1, round(BEGINNING / period))]
    known = known[np.isfinite(known)]
    return float(np.mean(known)) if len(known) else None


def positions(plant: Any, voltage: Floats, begin: float | None = None) -> Floats:
    """Readings [V] without noise, n, of a plant with Params ``plant`` under ``voltage`` [V], from rest.

    The spool rests where the reading is ``begin`` [V]: friction may hold it off the centre, and does so after
    any motion. None, and a plant whose module has no ``standing``: in the centre.
    """
    law = biquads.static_params(1.0, plant.u_max)
    rest = biquads.initial(law, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    module = registry.plant_of(plant).module
    state = module.initial(plant)
    if begin is not None and len(voltage) and hasattr(module, "standing"):
        state = module.standing(plant, begin - module.read(plant, state, 0.0), float(voltage[0]))
    n = len(voltage)
    signals = np.zeros((n, len(closed_loop.SIGNALS)))
    closed_loop.run_valve(
        biquads,
        closed_loop.parts(law, plant),
        closed_loop.parts(rest, state),
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


class _Form(NamedTuple):
    """What the unknowns of a search mean.

    Of each pair of poles, then of a single real one, logarithms of the coefficients, which stay between those
    of the slowest and of the fastest pole; numerator over its static part; friction [V], offset [V], dead
    time [periods]. All are of the size of 1.
    """

    order: int
    zeros: int  # coefficients of the numerator
    static_ratio: float
    period: float  # s

    def plant(self, x: Floats) -> Plant:
        """The valve with unknowns ``x``."""
        denominator = bode_fit.product(np.clip(x[: self.order], *self.coefficients()) - 1.0)
        scale = denominator[-1] ** (1.0 / self.order)
        ascending = [x[self.order + i] * denominator[-1] * scale**-i for i in range(self.zeros)]
        model = TransferFunction(tuple(map(float, ascending[::-1])), tuple(map(float, denominator)))
        friction = Friction(max(0.0, float(x[-3])), self.static_ratio)
        return Plant(model, friction, -float(x[-2]), float(x[-1]) * self.period, math.inf)

    def coefficients(self) -> tuple[Floats, Floats]:
        """Least and largest unknowns of the poles; those beyond are taken for these."""
        powers = np.array([1.0 + i % 2 for i in range(self.order)])
        return 1.0 + powers * math.log(SLOWEST_POLE), 1.0 + powers * math.log(_fastest(self.period))

    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the unknowns."""
        count = self.order + self.zeros + 3
        lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
        lower[-3], lower[-1], upper[-1] = 0.0, 0.0, max(LATEST, LATEST_TIME / self.period)
        return lower, upper

    def begin(self, fit: bode_fit.Fit, friction: Friction, offset: float) -> Floats:
        """Unknowns of a search that begins at ``fit``, within their bounds and not upon them."""
        roots, static = np.roots(fit.model.denominator), fit.model.denominator[-1]
        factor = np.minimum(1.0, FIRST_POLE * _fastest(self.period) / np.abs(roots))
        slowed = np.asarray(np.poly(factor * roots).real, dtype=np.float64)
        scale = float(slowed[-1]) ** (1.0 / fit.order)
        ascending = [c * scale**i / static for i, c in enumerate(reversed(fit.model.numerator))]
        least, most = self.coefficients()
        poles = np.clip(1.0 + bode_fit.factors(slowed[1:]), least + AWAY, most - AWAY)
        delay = min(max(fit.delay / self.period, 1e-3), self.bounds()[1][-1] - 1e-3)
        return np.array([*poles, *ascending, max(friction.coulomb, 1e-6), offset, delay])


class _Tests(NamedTuple):
    """Tests that a valve is fitted to."""

    records: Sequence[Record]
    weights: Sequence[Floats]  # of their samples
    tell: Callable[[], None]  # called before each simulation of a search

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return self.records[0].period

    def errors(self, plant: Plant) -> Floats:
        """Errors of ``plant`` over what is allowed, all samples of all tests; at most 1000."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                parts = [
                    np.where(w > 0.0, w * (simulated(plant, r) - np.nan_to_num(r.reading)), 0.0)
                    for r, w in zip(self.records, self.weights, strict=True)
                ]
        except ParameterError:  # such as one that moves against its voltage
            parts = [np.full(len(w), np.inf) for w in self.weights]
        errors: Floats = np.clip(np.nan_to_num(np.concatenate(parts), nan=1e3), -1e3, 1e3)
        return errors

    def judged(self, plant: Plant) -> Plant:
        """``plant`` with its error."""
        return plant._replace(error=float(np.sqrt(np.mean(self.errors(plant) ** 2))))


def _near(tests: _Tests, fit: bode_fit.Fit, friction: Friction, offset: float) -> Plant:
    """The valve of the form of ``fit`` near it, with this ``friction`` and ``offset`` [V] at first."""
    form = _Form(fit.order, len(fit.model.numerator), friction.static_ratio, tests.period)

    def residual(x: Floats) -> Floats:
        tests.tell()
        return tests.errors(form.plant(x))

    done = scipy.optimize.least_squares(
        residual, form.begin(fit, friction, offset), bounds=form.bounds(),
        diff_step=STEP, x_scale="jac", loss="soft_l1", max_nfev=EVALUATIONS,
    )  # fmt: skip
    return tests.judged(form.plant(done.x))


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
        max_nfev=MOST_EVALUATIONS, ftol=CONVERGED,
    )  # fmt: skip
    return of_unknowns(done.x, period)


def _with_solenoids(
    tests: _Tests, fits: Sequence[bode_fit.Fit], linear: Plant, friction: Friction, offset: float
) -> Plant:
    """The valve with solenoids near a third order of ``fits``, if clearly better than the ``linear`` one.

    A linear one with its friction, if that explains the readings as well and the coil is at its bound: such a
    short lag is no coil, and counts as dead time.
    """
    order = len(linear.model.denominator) - 1
    begin = next(
        (f for f in fits if f.order == 3 and len(f.model.numerator) == 1),
        next((f for f in fits if f.order == order), fits[0]),
    )

    def plant(m: Magnet) -> Plant:
        level = Friction(m.coulomb, m.static_ratio)
        return Plant(m.model, level, m.offset, m.delay, math.inf, m.presliding, m)

    def searched(own: _Tests, m: Magnet) -> Plant:
        found = refined(m, own.period, lambda m: own.errors(plant(m)), own.tell)
        return tests.judged(plant(found))

    guess = first_guess(begin.model, friction, -offset, begin.delay)
    nearest = searched(tests, guess)
    if nearest.error > SUSPECT:  # than a search over all tests the last one alone leads nearer to the valve
        alone = searched(tests._replace(records=tests.records[-1:], weights=tests.weights[-1:]), guess)
        if alone.magnet is not None:
            nearest = _best([nearest, searched(tests, alone.magnet)])
    m = nearest.magnet
    assert m is not None
    if abs(m.overlap) < TOLD_OVERLAP:
        # A fit is not so exact, and with an underlap, however small, the valve has twice the gain at 0 V.
        nearest = tests.judged(plant(m := m._replace(overlap=0.0)))
    if nearest.error >= SIMPLER * linear.error:
        return linear
    if m.coil > AT_BOUND * FASTEST_COIL:
        return nearest
    squared = m.speed**2
    model = TransferFunction((m.gain * squared,), (1.0, 2.0 * m.damping * m.speed, squared))
    simpler = tests.judged(nearest._replace(model=model, delay=m.delay + m.coil, magnet=None))
    return simpler if simpler.error <= AS_GOOD * nearest.error else nearest


def _fastest(period: float) -> float:
    """Bound of the poles [rad/s]."""
    return min(FASTEST_POLE / period, FASTEST_SPEED)
