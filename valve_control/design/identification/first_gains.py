# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives every law of the package gains with which it may run on an identified valve for a first time.

The gains of the paper belong to the D3FXE. They are carried over by what they mean: ρ by b0², the weight of
the voltage by the square of the static gain, PID's poles by the valve's speed. Each law's loop is then closed
around the identified model at the corners of a box, and its bandwidth is halved until all poles of the
sampled loop are inside the unit circle.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.laws import pid, reshaping
from valve_control.control.laws.dcarc_design import EXCESS, excess, without_fast_zero
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import stability
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import transfer_functions, valve
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.identification.characteristic import Characteristic
from valve_control.design.identification.friction import Friction
from valve_control.design.identification.lvdt import Lvdt
from valve_control.design.identification.theta import GAINS, SPEEDS, Suggestion
from valve_control.parameter import ParameterError, Values, defaults, number, numbers, updated

LATER = (0.0, 1.0)  # sample periods of dead time beyond what was identified
HALVINGS = 6
AHEAD = 1.1  # times the valve's natural frequency, where PID's poles are put
# What dcarc has for a friction that is known; other friction needs their usual values.
FRICTION_TERMS = (
    "dcarc.theta_initial", "dcarc.theta_min", "dcarc.theta_max", "dcarc.theta_spread", "dcarc.presliding",
    "dcarc.fit_noise", "dcarc.forgetting", "dcarc.learning_path",
)  # fmt: skip
# Powers of the bandwidth that gains go with. An estimate and the error that it corrects are a loop of second
# order, s² + k2·s + γ·φ²: γ goes with the square of k2, whatever the size of θ.
SCALED = {
    "arc": {"gamma": 2, "k1": 1, "k2": 1},
    "oarc": {"gamma": 2, "k1": 1, "k2": 2, "ks1": 1, "ks2": 1},
}
QUIETEST = 5e-4  # V  noise that is assumed at least: no model is so exact that readings could be believed
BRISTLES = (1, 2, 3)  # of dcarc's weights
PRESLIDINGS = (0.4, 1.0, 2.5)  # of the three bristles over the measured one
CLOSE, LEAST_SPREAD = 0.3, 0.1  # -, V  spread of the weights around the measured friction
HIGHEST = 1.5  # times the measured friction, up to which a weight may go
OFFSET_SPREAD = 0.2  # V
OFFSET_ROOM = 0.5  # V  beyond the measured offset, up to which a weight may go at least
LEAST_PLAY, LEAST_SIDES = 0.01, 0.02  # V and -, above which there are terms for them
REAL = 1e-6  # imaginary part of a real pole, at most, over its size
# Of dcarc on a valve whose coil, play and friction are known: the disturbance that is left is small.
KNOWN_WEIGHT, KNOWN_NOISE, KNOWN_RATE = 0.02, 0.5, 4.0  # -, V, V/√s
KNOWN_FIT, KNOWN_FORGETTING = 0.4, 0.05  # V, 1/s


class FirstGains(NamedTuple):
    """Parameters of the controller, and why laws have none."""

    values: Values
    refusals: Mapping[str, str]  # reason by law

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user."""
        return tuple(f"{law}'s gains are left out: {reason}" for law, reason in self.refusals.items())


class Magnet(NamedTuple):
    """What is known of the solenoids."""

    coil: float  # s  lag of the force behind the voltage, a pole of the model
    play: float  # V  half width of the hysteresis
    sides: float  # -  gain of the positive side over that of the negative, less 1


class KnownValve(NamedTuple):
    """What is known of the valve."""

    model: TransferFunction
    delay: float  # s  dead time that goes with it
    theta: Suggestion
    lvdt: Lvdt
    period: float  # s
    u_max: float  # V
    friction: Friction | None = None  # None: not tested
    sensor_delay: float = 0.0  # s  what of the dead time is the sensor's; the rest is the actuator's
    magnet: Magnet | None = None  # None: not known


def first(known: KnownValve, around: KnownValve | None = None) -> FirstGains:
    """Gains of ``pid``, ``arc``, ``oarc`` and ``dcarc``, and limits of the reference for an unusual valve.

    ``around``: the valve on which, and on whose box, they have to be stable, where ``known`` has a simpler
    model than that.
    """
    values: Values = {**reshaping.limits(known.model, known.u_max), **reshaping.at_period(known.period)}
    refusals: dict[str, str] = {}
    corners = list(_corners(known if around is None else around))
    for law in ("pid", "arc", "oarc", "dcarc"):
        try:
            values.update(_safe(law, known, corners))
        except ParameterError as error:
            refusals[law] = str(error)
    return FirstGains(values, refusals)


def _safe(law: str, known: KnownValve, corners: list[valve.Params]) -> Values:
    """Parameters of ``law`` with the highest bandwidth that is stable at all ``corners``.

    Raises ParameterError.
    """
    base = {**defaults(CONTROLLER), "sample_period": known.period, **reshaping.at_period(known.period)}
    for share in (0.5**i for i in range(HALVINGS + 1)):
        if law == "pid":
            gains = _pid(known, share)
        else:
            gains = dcarc_values(known, share) if law == "dcarc" else _adaptive(law, known, share)
        params = LAWS[law].build(updated(CONTROLLER, base, gains))
        if all(abs(stability.dominant_pole(LAWS[law], params, plant)) < 1.0 for plant in corners):
            return gains
    raise ParameterError(
        f"none were found that are stable with {GAINS[0]:g} to {GAINS[1]:g} times the gain, {SPEEDS[0]:g} to "
        f"{SPEEDS[1]:g} times the speed and {LATER[1]:g} sample period of dead time more"
    )


def _corners(known: KnownValve) -> Iterator[valve.Params]:
    """The identified valve, and the corners of the box around it."""
    for gain, speed, later in [(1.0, 1.0, 0.0), *product(GAINS, SPEEDS, LATER)]:
        model = transfer_functions.faster(known.model, gain, speed)
        lvdt = IDEAL._replace(delay=known.delay / known.period + later)
        yield valve.design(model, known.period, known.u_max, 1.0, valve.NO_DISTURBANCE, lvdt)


def _pid(known: KnownValve, share: float) -> Values:
    """Reference form: three poles of (55) where the valve's are, or what of them needs no negative gain."""
    a1, a0, b0 = known.theta.initial[:3]
    kp, ki, kd = pid.place_poles(AHEAD * math.sqrt(a0) / (2.0 * math.pi), a1, a0, b0)
    return rounded(
        {
            "pid.form": "reference",
            "pid.theta": [a1, a0, b0],
            "pid.kp": share * max(kp, 0.0),
            "pid.ki": share * ki,
            "pid.kd": share * max(kd, 0.0),
        }
    )


def _adaptive(law: str, known: KnownValve, share: float) -> Values:
    """Estimates, and default gains with a ``share`` of the bandwidth; oarc's ρ = b0² puts z2 on V/s."""
    values, own = known.theta.parameters(law), defaults(CONTROLLER)
    if law == "oarc":
        values["oarc.z2_weight"] = known.theta.initial[2] ** 2
    for gain, power in SCALED[law].items():
        values[f"{law}.{gain}"] = (share**power * np.asarray(own[f"{law}.{gain}"])).tolist()
    return rounded(values)


def _bristles(friction: Friction) -> Values:
    """Weights that begin at the measured friction, closer around it; the second bristle has its presliding.

    A presliding that was not told leaves those of the bristles as they are.
    """
    own = defaults(CONTROLLER)
    names = ("theta_initial", "theta_min", "theta_max", "theta_spread")
    start, lowest, highest, spread = (list(numbers(own, f"dcarc.{name}")) for name in names)
    start[2] = friction.coulomb
    start[6] = 0.0 - friction.offset
    for i in BRISTLES:
        highest[i] = max(highest[i], HIGHEST * friction.coulomb)
        spread[i] = max(CLOSE * friction.coulomb, LEAST_SPREAD)
    spread[6] = OFFSET_SPREAD
    lowest[6] = min(lowest[6], start[6] - OFFSET_ROOM)
    highest[6] = max(highest[6], start[6] + OFFSET_ROOM)
    rows = zip(names, (start, lowest, highest, spread), strict=True)
    values: Values = {f"dcarc.{name}": row for name, row in rows}
    if friction.presliding > 0.0:
        values["dcarc.presliding"] = [share * friction.presliding for share in PRESLIDINGS]
    return values


def dcarc_values(known: KnownValve, share: float = 1.0) -> Values:
    """The model itself, its noises and friction, and the weight of the voltage by the static gain squared.

    Less bandwidth is a larger weight of the voltage, and a disturbance that is expected to change less.
    """
    own = defaults(CONTROLLER)
    model = without_fast_zero(known.model, known.period)
    gain = known.model.static_gain / transfer_functions.FOURTH_ORDER.static_gain
    slower: Values = {}
    if share < 1.0:  # the disturbance's estimate is a part of the loop too
        slower["dcarc.disturbance_rate"] = share**2 * number(own, "dcarc.disturbance_rate")
    behind = min(known.delay, known.sensor_delay)
    return rounded(
        {
            **(_bristles(known.friction) if known.friction is not None else {}),
            **slower,
            "dcarc.model": "custom",
            "dcarc.numerator": list(model.numerator),
            "dcarc.denominator": list(model.denominator),
            "dcarc.delay": behind,
            "dcarc.actuator_delay": known.delay - behind,
            "dcarc.lvdt_noise": max(known.lvdt.noise, QUIETEST),
            "dcarc.lvdt_resolution": known.lvdt.resolution,
            "dcarc.voltage_weight": number(own, "dcarc.voltage_weight") * gain**2 / share**2,
            **_solenoids(known, share),
        }
    )


def _solenoids(known: KnownValve, share: float) -> Values:
    """Terms of dcarc for coil, play and unequal gains, and gains for a valve that is known so well.

    There is a term for what is larger than what a fit leaves in doubt.
    """
    magnet = known.magnet
    if magnet is None or excess(known.model) <= EXCESS[0]:
        return {"dcarc.coil": 0.0, "dcarc.hysteresis": 0.0, "dcarc.sides": 0.0}  # nothing of another valve
    terms: Values = {
        "dcarc.coil": magnet.coil,
        "dcarc.hysteresis": magnet.play if magnet.play > LEAST_PLAY else 0.0,
        "dcarc.sides": abs(magnet.sides) if abs(magnet.sides) > LEAST_SIDES else 0.0,
    }
    if known.friction is None:
        return terms
    scale = known.model.static_gain / transfer_functions.FOURTH_ORDER.static_gain
    close = max(CLOSE * known.friction.coulomb, LEAST_SPREAD)
    return {
        **terms,
        "dcarc.voltage_weight": KNOWN_WEIGHT * scale**2 / share**2,
        "dcarc.input_noise": KNOWN_NOISE,
        "dcarc.disturbance_rate": share**2 * KNOWN_RATE,
        "dcarc.theta_spread": [0.1, close, close, close, close, 0.1, OFFSET_SPREAD, 0.0, 0.0],
        "dcarc.fit_noise": KNOWN_FIT,
        "dcarc.forgetting": KNOWN_FORGETTING,
    }


def magnet_of(model: TransferFunction, curve: Characteristic | None) -> Magnet | None:
    """Coil, play and unequal gains that ``model`` and the characteristic ``curve`` show.

    The coil is the fastest pole of a model with three more poles than zeros. None: that is no real pole, or
    there are fewer poles.
    """
    if excess(model) <= EXCESS[0]:
        return None
    fastest = max(np.roots(model.denominator), key=abs)
    if abs(fastest.imag) > REAL * abs(fastest):
        return None
    play, sides = 0.0, 0.0
    if curve is not None:
        play = 0.0 if curve.shares is None else curve.shares.play
        sides = curve.positive.gain.value / curve.negative.gain.value - 1.0 if curve.lopsided else 0.0
    return Magnet(-1.0 / float(fastest.real), play, sides)


def without_play(rubbing: Friction | None, curve: Characteristic | None) -> Friction | None:
    """Friction without the play of the magnet, where the ``curve`` tells the two apart."""
    if rubbing is None or curve is None or curve.shares is None or curve.shares.play <= LEAST_PLAY:
        return rubbing
    return rubbing._replace(coulomb=curve.shares.friction, presliding=curve.shares.presliding)


def rounded(values: Values) -> Values:
    """Ten digits of each number."""

    def short(value: Any) -> Any:
        if isinstance(value, (list, tuple)):
            return [short(one) for one in value]
        return float(f"{value:.10g}") if isinstance(value, float) else value

    return {name: short(value) for name, value in values.items()}
