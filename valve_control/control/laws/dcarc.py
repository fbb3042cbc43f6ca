# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Desired-compensation adaptive robust control with a Kalman observer.

The derivation is in docs/explanation/laws/dcarc.md.

The voltage of the inverted model and a compensation that is learned come from the reference alone, free
of noise. A steady-state Kalman filter estimates state and input disturbance from the reading, LQR feeds back
what is left of the error. The weights of the compensation are fitted to the estimated disturbance by least
squares.
"""

import math
import sys
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.laws import dcarc_parts as parts
from valve_control.control.laws import least_squares, magnet, reshaping
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law
from valve_control.control.laws.least_squares import NOTHING, Weights
from valve_control.control.laws.projection import clip
from valve_control.control.laws.signals import Start
from valve_control.control.plant import transfer_functions
from valve_control.control.plant.saturation import saturate
from valve_control.control.plant.transfer_functions import Scale, TransferFunction
from valve_control.parameter import Parameter, ParameterError, Table, Values, defaults, number, numbers

WEIGHTS = (
    "[gain -, bristle V, bristle V, bristle V, standstill V, flow force V/V, offset V, damping V/(V/s), "
    "inertia V/(V/s²)]"
)
CALM = 0.1  # s  after which a reference that has come to rest tells nothing more of the weights
MEMORY = 0.2  # s  over which the mean squares of the disturbance are taken
ALLOWED = 1.5  # of the disturbance over what is assumed, in mean squares
FORM = (
    *("model", "numerator", "denominator", "coil", "delay", "actuator_delay", "smoothing"),
    *("hysteresis", "sides", "hum"),
)
NAMES = ("gain", "bristle", "bristle", "bristle", "standstill", "flow force", "offset", "damping", "inertia")


RESTING = magnet.Terms(0.0, 0.0, magnet.NONE, magnet.NONE)
TURN = 0.25  # of the half width of the hysteresis, over which the direction of the force turns
SPREAD = 0.5  # of the half width, standard deviation of its weight
HIGHEST = 3.0  # half widths, up to which its weight may go
SIDES = 0.5  # -  difference of the gains of both sides, up to which its weight may go


class Bristles(NamedTuple):
    """Deflections of three bristles over those of sliding, or their presliding [V]."""

    first: float
    second: float
    third: float


class Params(NamedTuple):
    """Constants of the law."""

    model: parts.Model
    kalman: parts.KalmanGains
    turn: parts.Turn
    feedback: parts.Row  # K of LQR, on the state when the voltage begins to act
    waiting: parts.Past  # the same on voltages that have not acted yet
    unexplained: float  # the same on the disturbance
    wanted: parts.Combination  # K·x_r
    full: parts.Move  # over one period
    half: parts.Move  # over half a period
    model_voltage: parts.Combination  # u_r
    standing: parts.Rest  # for each 1 V
    moving: parts.Rest  # for each 1 V/s
    presliding: Bristles  # V
    standstill_rate: float  # V/s
    jitter: float  # V/s    mean speed at which noise shakes the spool
    lag_share: float  # -      share of the way that the regressor's lag goes in a period
    theta_initial: Weights
    theta_min: Weights
    theta_max: Weights
    prior: Weights  # variances of the initial weights
    forget: float  # -      share of what is known of the weights that is lost in a sample of motion
    calm: float  # -      share of the motion that is left a sample later
    learning_path: float  # V      of the reference after a start, until which the weights rest
    fit_variance: float  # V²     of the estimated disturbance around what the weights can explain
    memory: float  # -      share of a sample in the mean squares of ``Burden``
    assumed: Weights  # variances of the initial weights from which the valve has left what is assumed
    assumed_variance: float  # V²     likewise of what the weights cannot explain
    magnet: magnet.Params
    equivalent: parts.Equivalent
    u_max: float  # V
    period: float  # s
    reshaping: reshaping.Params


class Estimate(NamedTuple):
    """What the observer knows: state of the model, disturbance and past positions."""

    state: parts.Row  # position [V], velocity [V/s] and up to four inner states
    disturbance: float  # V  at the input, without what the compensation makes good
    past: parts.Past  # V
    held: parts.Past  # V  voltages of the samples before, on the model
    hum: parts.Wave


class Fit(NamedTuple):
    """What is learned."""

    regressor: Weights  # as late as the estimated disturbance
    variance: Weights  # of the weights
    moving: float  # -  1.0 while the reference moves, going to 0.0 when it rests
    path_left: float  # V  of the reference, until the weights adapt


class Burden(NamedTuple):
    """Disturbance that the initial weights leave to observer and fit, in mean squares over MEMORY."""

    found: float  # V²
    assumed: float  # V²


class State(NamedTuple):
    """Reference, inverse of the model, bristles, observer and what is learned."""

    reference: reshaping.State
    smooth: float  # V    the reference behind the filter that gives it a third derivative
    rate_before: float  # V/s  rate of the latter a sample ago
    inverse: parts.Inverse
    bristles: Bristles
    estimate: Estimate  # predicted for this sample
    fit: Fit
    burden: Burden
    theta: Weights
    magnet: magnet.State


class Desired(NamedTuple):
    """What the reference asks for in the middle of the coming period."""

    force: Weights  # regressor of the fit
    voltage: Weights  # regressor of the compensation, led by the coil
    bristles: Bristles  # at the end of the period
    force_rate: float  # V/s  of the force that the voltage of the inverted model makes
    magnet: magnet.Terms


class Terms(NamedTuple):
    """What the law computed at this sample."""

    reference: float  # V     x_vd
    reference_rate: float  # V/s
    reference_accel: float  # V/s²
    position: float  # V     estimate of the true position, without the LVDT's dead time
    velocity: float  # V/s   estimate
    z1: float  # V     tracking error
    innovation: float  # V     reading minus what the observer expected
    disturbance: float  # V     input disturbance that the compensation does not explain
    burden: float  # V²    mean square of what the initial weights would leave to the observer
    burden_bound: float  # V²    most of it that is assumed
    model_voltage: float  # V     u_r
    compensation_voltage: float  # V     u_c
    feedback_voltage: float  # V     -K(x̂ - x_r)
    unsaturated_voltage: float  # V
    gain: float  # weights, used at this sample
    bristle1: float
    bristle2: float
    bristle3: float
    standstill: float
    flow: float
    offset: float
    damping: float
    inertia: float


def corrected(p: Params, e: Estimate, innovation: float) -> Estimate:
    """Estimate with the reading taken in, which is ``innovation`` [V] off what was predicted."""
    g, hum = p.kalman, e.hum
    if p.turn.on > 0.0:
        hum = parts.Wave(hum.shown + g.hum.shown * innovation, hum.ahead + g.hum.ahead * innovation)
    return Estimate(
        parts.plus(e.state, g.state, innovation),
        e.disturbance + g.disturbance * innovation,
        parts.past_plus(e.past, g.past, innovation),
        e.held,
        hum,
    )


def predicted(p: Params, e: Estimate, voltage: float, explained: float) -> Estimate:
    """Estimate for the next sample, with ``voltage`` [V] on the model.

    ``explained`` [V]: what the compensation makes good of the disturbance from now on.
    """
    m, x, d = p.model, e.state, e.disturbance
    acting = voltage
    if m.waits > 0.0:
        acting = m.direct * voltage + parts.past_dot(m.acting, e.held)
    u = acting + d
    state = parts.plus(parts.plus(parts.times(m, x), m.input, u), m.force, d)
    first = parts.dot(m.passing, x) + m.passing_input * u + m.passing_force * d
    if m.waits > 0.0:
        leaving = parts.past_dot(m.leaving, e.held)  # acts at the beginning of the period
        state = parts.plus(state, m.early, leaving)
        first = first + m.passing_early * leaving
    return Estimate(
        state,
        d + explained,
        parts.Past(first, e.past.first, e.past.second, e.past.third),
        parts.Past(voltage, e.held.first, e.held.second, e.held.third),
        parts.turned(p.turn, e.hum) if p.turn.on > 0.0 else e.hum,
    )


def dragged(deflection: float, way: float, path: float) -> float:
    """Deflection of a bristle after ``way`` preslidings, implicit Euler of dz/dt = (v - s·z)/δ.

    ``path``: preslidings of the mean speed s in the period, |v| and what the jitter of the spool adds to it.
    """
    return (deflection + way) / (1.0 + path)


def desired(p: Params, s: State, accel: float) -> Desired:
    """Regressors in the middle of the coming period, and the bristles at its end.

    The voltage of a force F is F + τ_c·dF/dt. All is from the reference; ``accel`` [V/s²]: its acceleration
    from the next sample on. (11) has the rate of the coming period, and the acceleration in the middle is the
    mean of those at both ends, the jerk their difference.
    """
    reference, rate, accel = reshaping.smoothed(p.reshaping, s.reference, accel, s.smooth)
    before = (rate - s.rate_before) / p.period
    middle = parts.Course(
        reference + 0.5 * p.period * rate, rate, 0.5 * (accel + before), (accel - before) / p.period
    )
    voltage = parts.combined(p.model_voltage, parts.moved(p.half, s.inverse, reference, rate), middle)
    way, path = rate * p.period, math.sqrt(rate * rate + p.jitter * p.jitter) * p.period
    bristles = Bristles(
        dragged(s.bristles.first, way / p.presliding.first, path / p.presliding.first),
        dragged(s.bristles.second, way / p.presliding.second, path / p.presliding.second),
        dragged(s.bristles.third, way / p.presliding.third, path / p.presliding.third),
    )
    share = rate / p.standstill_rate
    slow = 1.0 / (1.0 + share * share)
    standstill = bristles.second / (1.0 + share * share)
    coil, lead = p.magnet.coil, p.magnet.lead
    force, force_rate = voltage, 0.0
    if p.magnet.on > 0.0 or coil > 0.0:
        force, force_rate = magnet.forced(p.magnet, s.magnet, voltage, p.period)
    fitted = Weights(
        force,
        bristles.first,
        bristles.second,
        bristles.third,
        standstill,
        middle.reference,
        1.0,
        rate,
        middle.accel,
    )
    compensated = fitted
    if coil > 0.0:
        second = bristles.second + lead * (bristles.second - s.bristles.second)
        compensated = Weights(
            voltage,
            bristles.first + lead * (bristles.first - s.bristles.first),
            second,
            bristles.third + lead * (bristles.third - s.bristles.third),
            second * slow,
            middle.reference + coil * rate,
            1.0,
            rate + coil * middle.accel,
            middle.accel + coil * middle.jerk,
        )
    extra = RESTING
    if p.magnet.on > 0.0:
        total = force + least_squares.dot(s.theta, fitted)
        led = voltage + least_squares.dot(s.theta, compensated)
        extra = magnet.terms(p.magnet, s.magnet, total, led)
    return Desired(fitted, compensated, bristles, force_rate, extra)


def fitted(p: Params, s: State, force: Weights, variance: Weights) -> Fit:
    """What the fit has at the next sample, with the regressor ``force`` of this one.

    At rest all regressors are constant, and nothing tells one weight from another.
    """
    share = s.reference.rate / p.standstill_rate
    return Fit(
        least_squares.lagged(s.fit.regressor, force, p.lag_share),
        variance,
        max(p.calm * s.fit.moving, share * share / (1.0 + share * share)),
        max(s.fit.path_left - abs(s.reference.rate) * p.period, 0.0),
    )


def weighed(p: Params, s: State, left: float) -> Burden:
    """Burden with one more sample, at which the present weights leave ``left`` [V] to the observer."""
    x, before = s.fit.regressor, s.burden
    found = left - least_squares.change(s.theta, p.theta_initial, x)
    assumed = p.assumed_variance + least_squares.dot(least_squares.product(p.assumed, x), x)
    if p.magnet.on > 0.0:
        m = s.magnet
        found -= magnet.change(m.weights, p.magnet.initial, m.regressor)
        assumed += magnet.dot(magnet.product(p.magnet.prior, m.regressor), m.regressor)
    return Burden(
        before.found + p.memory * (found * found - before.found),
        before.assumed + p.memory * (assumed - before.assumed),
    )


def initial(p: Params, start: Start) -> State:
    """State that starts at ``start`` with the initial weights and relaxed bristles.

    The observer is where a steady motion at ``start.velocity`` would have brought it. What the voltage of
    ``start`` differs by from that of the model, and from the compensation, is its disturbance.
    """
    v, t, ages = start.velocity, p.theta_initial, p.model.ages
    position = start.measurement + v * parts.past_dot(p.model.shown, ages)
    s, m = p.standing, p.moving
    state = parts.plus(parts.scaled(s.state, position), m.state, v)
    past = parts.past_plus(parts.Past(position, position, position, position), ages, -v)
    reference, rate = start.reference, start.reference_rate
    inverse = parts.Inverse(
        s.inverse.zeta * reference + m.inverse.zeta * rate,
        s.inverse.rate * reference + m.inverse.rate * rate,
        s.inverse.accel * reference + m.inverse.accel * rate,
        s.inverse.jerk * reference + m.inverse.jerk * rate,
    )
    force = parts.combined(p.model_voltage, inverse, parts.Course(reference, rate, 0.0, 0.0))
    others = t.flow * reference + t.offset + t.damping * rate
    sent = (start.voltage - others) / (1.0 + t.gain)
    disturbance = s.voltage * position + m.voltage * v - sent
    return State(
        reshaping.State(reshaping.unsmoothed(p.reshaping, reference, rate), rate),
        reference,
        rate,
        inverse,
        Bristles(0.0, 0.0, 0.0),
        Estimate(state, disturbance, past, parts.Past(sent, sent, sent, sent), parts.Wave(0.0, 0.0)),
        Fit(NOTHING, p.prior, 0.0, p.learning_path),
        Burden(0.0, p.fit_variance),
        t,
        magnet.State(force, 0.0, force, 0.0, p.magnet.initial, magnet.NONE, p.magnet.prior),
    )


def compensated(p: Params, s: State, d: Desired) -> float:
    """Voltage [V] of the compensation without the gain's part."""
    others = least_squares.dot(s.theta, d.voltage) - s.theta.gain * d.voltage.gain
    if p.magnet.on > 0.0:
        others += magnet.dot(s.magnet.weights, d.magnet.voltage)
    return others


def advanced(
    p: Params, s: magnet.State, d: Desired, left: float, sharpness: float, fresh: float
) -> magnet.State:
    """The magnet a sample later, its weights fitted like the others to ``left`` [V] (as in ``step``)."""
    m = p.magnet
    if m.on == 0.0:
        if m.coil == 0.0:
            return s
        return magnet.State(d.force.gain, d.force_rate, 0.0, 0.0, s.weights, s.regressor, s.variance)
    px = magnet.product(s.variance, s.regressor)
    step, forget = left * sharpness, p.forget * fresh
    return magnet.State(
        d.force.gain,
        d.force_rate,
        d.magnet.total,
        d.magnet.direction,
        magnet.Pair(
            clip(s.weights.direction - px.direction * step, m.lower.direction, m.upper.direction),
            clip(s.weights.positive - px.positive * step, m.lower.positive, m.upper.positive),
        ),
        magnet.lagged(s.regressor, d.magnet.force, p.lag_share),
        magnet.Pair(
            least_squares.sharper(s.variance.direction, px.direction, sharpness, forget, m.prior.direction),
            least_squares.sharper(s.variance.positive, px.positive, sharpness, forget, m.prior.positive),
        ),
    )


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """One sample: returns voltage [V] within ±u_max, the next state and the terms.

    The model takes the voltage after saturation, so that the observer stays true. The weights rest while
    the amplifier saturates, since the valve then does not follow the reference, of which the regressor is
    made, while the reference rests, and until it has travelled ``learning_path`` after a start.
    """
    shaping = reshaping.acceleration(p.reshaping, s.reference, command)
    reference, rate, accel = reshaping.smoothed(p.reshaping, s.reference, shaping, s.smooth)
    d = desired(p, s, shaping)
    phi = d.voltage

    innovation = (
        measurement - p.model.present * s.estimate.state.x0 - parts.past_dot(p.model.shown, s.estimate.past)
    )
    if p.turn.on > 0.0:
        innovation -= s.estimate.hum.shown
    estimate = corrected(p, s.estimate, innovation)

    scale = 1.0 + s.theta.gain
    others = compensated(p, s, d)
    before = parts.Course(reference, 0.5 * (rate + s.rate_before), (rate - s.rate_before) / p.period, 0.0)
    aim = parts.combined(p.wanted, s.inverse, before)
    feedback = aim - parts.dot(p.feedback, estimate.state)
    if p.model.waits > 0.0:
        feedback -= parts.past_dot(p.waiting, estimate.held) + p.unexplained * estimate.disturbance
    unsaturated = scale * (phi.gain + feedback - estimate.disturbance) + others
    wanted = unsaturated + offset
    voltage = saturate(wanted, p.u_max)

    delayed = s.fit.regressor
    px = least_squares.product(s.fit.variance, delayed)
    spread = p.fit_variance + least_squares.dot(px, delayed)
    if p.magnet.on > 0.0:
        spread += magnet.dot(magnet.product(s.magnet.variance, s.magnet.regressor), s.magnet.regressor)
    sharpness = 1.0 / spread
    fresh = s.fit.moving  # share of a sample that there is to learn from
    if voltage != wanted or s.fit.path_left > 0.0:
        fresh = 0.0
    sharpness *= fresh
    left = scale * estimate.disturbance
    theta = least_squares.moved(s.theta, px, left * sharpness, p.theta_min, p.theta_max)
    variance = least_squares.learned(s.fit.variance, px, sharpness, p.forget * fresh, p.prior)
    extra = advanced(p, s.magnet, d, left, sharpness, fresh)
    explained = least_squares.change(theta, s.theta, delayed) / scale
    if p.magnet.on > 0.0:
        explained += magnet.change(extra.weights, s.magnet.weights, s.magnet.regressor) / scale
    burden = weighed(p, s, left)
    state = State(
        reshaping.advance(p.reshaping, s.reference, shaping),
        reference + rate * p.period,
        rate,
        parts.moved(p.full, s.inverse, reference, rate),
        d.bristles,
        predicted(p, estimate, (voltage - others) / scale, explained),
        fitted(p, s, d.force, variance),
        burden,
        theta,
        extra,
    )
    terms = Terms(
        reference=reference,
        reference_rate=rate,
        reference_accel=accel,
        position=estimate.state.x0,
        velocity=estimate.state.x1,
        z1=measurement - reference,
        innovation=innovation,
        disturbance=estimate.disturbance,
        burden=burden.found,
        burden_bound=ALLOWED * burden.assumed,
        model_voltage=phi.gain,
        compensation_voltage=s.theta.gain * phi.gain + others,
        feedback_voltage=scale * feedback,
        unsaturated_voltage=unsaturated,
        gain=s.theta.gain,
        bristle1=s.theta.bristle1,
        bristle2=s.theta.bristle2,
        bristle3=s.theta.bristle3,
        standstill=s.theta.standstill,
        flow=s.theta.flow,
        offset=s.theta.offset,
        damping=s.theta.damping,
        inertia=s.theta.inertia,
    )
    return voltage, state, terms


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample at which nothing was read: ``voltage`` [V] held on, the weights rest.

    The observer goes on with its model; ``measurement`` [V], a straight line between the readings before and
    after the gap, would tell it less.
    """
    shaping = reshaping.acceleration(p.reshaping, s.reference, command)
    reference, rate, _ = reshaping.smoothed(p.reshaping, s.reference, shaping, s.smooth)
    d = desired(p, s, shaping)
    others = compensated(p, s, d)
    return State(
        reshaping.advance(p.reshaping, s.reference, shaping),
        reference + rate * p.period,
        rate,
        parts.moved(p.full, s.inverse, reference, rate),
        d.bristles,
        predicted(p, s.estimate, (voltage - others) / (1.0 + s.theta.gain), 0.0),
        fitted(p, s, d.force, s.fit.variance),
        s.burden,
        s.theta,
        advanced(p, s.magnet, d, 0.0, 0.0, 0.0),
    )


def _row(name: str, usual: list[float], text: str, low: float) -> Parameter:
    """Row of the table for nine numbers of the weights, from ``low`` on."""
    return Parameter(f"dcarc.theta_{name}", list(usual), "", f"{text}: {WEIGHTS}", low, 1e3, length=9)


PARAMETERS: Table = (
    Parameter(
        "dcarc.model",
        "fourth_order",
        "",
        "valve model for inverse and observer: (2), (3) or custom",
        choices=("second_order", "fourth_order", "custom"),
    ),
    *transfer_functions.custom_parameters("dcarc."),
    Parameter(
        "dcarc.smoothing", 0.001, "s", "filter behind (8) for a third derivative, with a coil", 1e-5, 0.1
    ),
    Parameter("dcarc.coil", 0.0, "s", "lag of the force behind the voltage, a pole; 0.0: none", 0.0, 0.1),
    Parameter(
        "dcarc.hysteresis", 0.0, "V", "half width of the hysteresis, initial weight; 0.0: none", 0.0, 10.0
    ),
    Parameter(
        "dcarc.sides", 0.0, "-", "expected difference of the gains of two solenoids; 0.0: none", 0.0, 1.0
    ),
    Parameter("dcarc.lvdt_noise", 0.0056, "V", "standard deviation of the LVDT's noise", 1e-6, 10.0),
    Parameter("dcarc.lvdt_resolution", 0.0037, "V", "step of the LVDT's converter", 0.0, 10.0),
    Parameter("dcarc.delay", 0.0, "s", "dead time of LVDT and bus, at most 4 sample periods", 0.0, 0.4),
    Parameter(
        "dcarc.actuator_delay", 0.0, "s", "dead time before the valve, at most 4 sample periods", 0.0, 0.4
    ),
    Parameter(
        "dcarc.hum", 0.0, "Hz", "hum in the reading that is no motion, such as 50; 0.0: none", 0.0, 1000.0
    ),
    Parameter("dcarc.input_noise", 1.2, "V", "input noise of a sample, assumed", 0.0, 1e3),
    Parameter("dcarc.disturbance_rate", 6.0, "V/√s", "random walk of the disturbance, assumed", 1e-3, 1e4),
    Parameter(
        "dcarc.voltage_weight", 0.17, "V²/V²", "weight of the voltage against the error in LQR", 1e-9, 1e6
    ),
    Parameter(
        "dcarc.presliding", [0.007, 0.018, 0.044], "V", "presliding of three bristles", 1e-6, 10.0, length=3
    ),
    Parameter("dcarc.standstill_rate", 0.32, "V/s", "rate at which this term has half its value", 1e-6, 1e4),
    _row("initial", [0.0] * 9, "initial weights of the compensation, setting which restarts them", -1e3),
    _row(
        "min", [-0.4, -3.0, -3.0, -3.0, -3.0, -1.0, -1.0, -0.03, -0.0003], "lower bounds of the weights", -1e3
    ),
    _row("max", [0.6, 3.0, 3.0, 3.0, 3.0, 1.0, 1.0, 0.03, 0.0003], "upper bounds of the weights", -1e3),
    _row(
        "spread",
        [0.2, 0.46, 0.46, 0.46, 1.1, 1.3, 1.0, 1.8e-5, 3.4e-5],
        "standard deviations of the weights around the initial ones; 0.0 switches a term off; the "
        "assumption monitor uses at least the defaults",
        0.0,
    ),
    Parameter("dcarc.fit_noise", 1.2, "V", "noise in the fit; a larger one adapts more slowly", 1e-4, 1e3),
    Parameter(
        "dcarc.forgetting", 0.2, "1/s", "rate at which variances return to initial; 0.0: never", 0.0, 100.0
    ),
    Parameter("dcarc.learning_path", 0.0, "V", "path of the reference until which weights rest", 0.0, 1e3),
)


USUAL = defaults(PARAMETERS)


def _weights(values: Values) -> tuple[Weights, Weights, Weights, Weights]:
    """Initial weights, bounds and spreads. Raises ParameterError."""
    start, lower, upper, spread = (
        numbers(values, f"dcarc.theta_{what}") for what in ("initial", "min", "max", "spread")
    )
    for i, name in enumerate(NAMES):
        if not lower[i] <= start[i] <= upper[i]:
            raise ParameterError(
                f"dcarc.theta_initial[{i}] ({name}) is {start[i]:g}; it must lie between "
                f"dcarc.theta_min[{i}], {lower[i]:g}, and dcarc.theta_max[{i}], {upper[i]:g}"
            )
    if lower[0] <= -1.0:
        raise ParameterError(
            f"dcarc.theta_min[0] (gain) is {lower[0]:g}; it must be above -1, since 1 + it scales the voltage"
        )
    return Weights(*start), Weights(*lower), Weights(*upper), Weights(*spread)


def _magnet(values: Values, period: float) -> magnet.Params:
    half, sides, coil = (number(values, f"dcarc.{name}") for name in ("hysteresis", "sides", "coil"))
    most_sides = SIDES if sides > 0.0 else 0.0
    return magnet.Params(
        on=1.0 if half > 0.0 or sides > 0.0 else 0.0,
        coil=coil,
        lead=coil / period,
        turn=TURN * half if half > 0.0 else 1.0,
        initial=magnet.Pair(half, 0.0),
        lower=magnet.Pair(0.0, -most_sides),
        upper=magnet.Pair(HIGHEST * half, most_sides),
        prior=magnet.Pair((SPREAD * half) ** 2, sides**2),
    )


DESIGNED = {
    **{name: name for name in ("delay", "input_noise", "disturbance_rate", "voltage_weight", "coil", "hum")},
    "noise": "lvdt_noise",
    "resolution": "lvdt_resolution",
    "dead_time": "actuator_delay",
}  # arguments of the design, and the parameters that give them


def _assumed(spread: Weights, noise: float) -> tuple[Weights, float]:
    """Spreads of the weights and noise [V] that are assumed of the valve: the usual ones at least.

    A search makes both small to calm the adaptation, which says nothing of the valve.
    """
    usual, usual_noise = numbers(USUAL, "dcarc.theta_spread"), number(USUAL, "dcarc.fit_noise")
    assumed = Weights(*(max(s, u) if s > 0.0 else 0.0 for s, u in zip(spread, usual, strict=True)))
    return assumed, max(noise, usual_noise)


def build(values: Values) -> Params:
    """Law from the controller's values. Raises ParameterError."""
    from valve_control.control.laws import dcarc_design  # scipy.linalg takes a while

    period = number(values, "sample_period")
    start, lower, upper, spread = _weights(values)
    noise = number(values, "dcarc.fit_noise")
    assumed, assumed_noise = _assumed(spread, noise)
    valve_model = transfer_functions.chosen(values, "dcarc.model", "dcarc.")
    given = {argument: number(values, f"dcarc.{name}") for argument, name in DESIGNED.items()}
    made = dcarc_design.design(valve_model, period, **given)
    return Params(
        **made,
        presliding=Bristles(*numbers(values, "dcarc.presliding")),
        standstill_rate=number(values, "dcarc.standstill_rate"),
        theta_initial=start,
        theta_min=lower,
        theta_max=upper,
        prior=least_squares.product(spread, spread),
        forget=-math.expm1(-number(values, "dcarc.forgetting") * period),
        calm=math.exp(-period / CALM),
        learning_path=number(values, "dcarc.learning_path"),
        fit_variance=noise**2,
        memory=-math.expm1(-period / MEMORY),
        assumed=least_squares.product(assumed, assumed),
        assumed_variance=assumed_noise**2,
        magnet=_magnet(values, period),
        u_max=number(values, "u_max"),
        period=period,
        reshaping=reshaping.build(values)._replace(
            smoothing=_smoothing(values),
            dead_time=number(values, "dcarc.actuator_delay"),
        ),
    )


def lag(values: Values) -> float:
    """Time [s] by which the spool is behind a ramp: filter (8), that behind it, dead time of the actuator."""
    smoothing = _smoothing(values)
    behind = 1.0 / smoothing if smoothing > 0.0 else 0.0
    return reshaping.lag(values) + behind + number(values, "dcarc.actuator_delay")


def _smoothing(values: Values) -> float:
    """Speed [1/s] of the filter behind (8), sampled; 0.0: the model needs none."""
    from valve_control.control.laws import dcarc_design  # scipy.linalg takes a while

    if dcarc_design.excess(transfer_functions.chosen(values, "dcarc.model", "dcarc.")) <= 2:
        return 0.0
    period = number(values, "sample_period")
    return -math.expm1(-period / number(values, "dcarc.smoothing")) / period


def model(p: Params) -> tuple[float, float, float]:
    """a1, a0 and b0 of the second-order model of the same slow behaviour."""
    return p.equivalent.a1, p.equivalent.a0, p.equivalent.b0


def sampled_model(p: Params) -> tuple[Floats, Floats] | None:
    """The model itself, with the voltages on their way to it as more states; None: ``model`` will do.

    That is the case with two more poles than zeros, order 2 to 4 and no dead time of the actuator.
    """
    m = p.model
    if p.reshaping.smoothing == 0.0 and not any(m.row4) and m.waits == 0.0:
        return None
    n, held = len(m.input), len(m.acting)
    a, b = np.zeros((n + held, n + held)), np.zeros(n + held)
    a[:n, :n] = [m.row0, m.row1, m.row2, m.row3, m.row4, m.row5]
    a[:n, n:] = np.outer(m.input, m.acting) + np.outer(m.early, m.leaving)
    a[n + 1 :, n:-1] = np.eye(held - 1)
    b[:n], b[n] = m.direct * np.array(m.input), 1.0
    return a, b


def without_adaptation(p: Params, s: State) -> tuple[Params, State]:
    """The law with its weights at rest."""
    still = p._replace(prior=NOTHING, magnet=p.magnet._replace(prior=magnet.NONE))
    return still, s._replace(
        fit=s.fit._replace(variance=NOTHING), magnet=s.magnet._replace(variance=magnet.NONE)
    )


# Gains to search from. With three more poles than zeros hardly any gains in the ranges keep the margins. LQR
# and Kalman filter are designed for a few bandwidths, from loops that are tight on a valve that is known well
# to loops that bear another gain and speed.
PRESLIDINGS = (0.4, 1.0, 2.5)  # of the three bristles over that of the valve
LOOPS = ((0.05, 4.0), (0.15, 2.0), (0.5, 4.0), (0.5, 2.0))  # weight at the gain of the D3FXE, V/√s
INPUT_NOISE, FIT_NOISE, FORGETTING = 0.5, 0.4, 0.05  # V, V, 1/s
RUBBING, LEAST = 0.3, 0.1  # of the friction that is known, and V: spread of the weights of bristles
OTHERS = (0.1, 0.1, 0.2, 0.0, 0.0)  # of gain, and of flow force, offset, damping and inertia


def of_model(model: TransferFunction, period: float) -> TransferFunction:
    """The ``model`` of a valve as the law takes it at ``period`` [s]."""
    from valve_control.control.laws import dcarc_design  # scipy.linalg takes a while

    return dcarc_design.without_fast_zero(model, period)


def of_plant(values: Values, plant: Values) -> Values:
    """Coil, play, friction and unequal gains of a simulated ``plant`` with solenoids; {}: it has none.

    Friction and offset are those of the law's model: voltages at its input, whose gain is the mean of both
    sides (``solenoid_valve.transfer``). ``values``: of the controller.
    """
    if plant["valve"] != "solenoid":
        return {}
    positive, negative = number(plant, "solenoid.positive"), number(plant, "solenoid.negative")
    side = 0.5 * (positive + negative)  # force per voltage
    weights = Weights(*numbers(values, "dcarc.theta_initial"))._replace(
        bristle2=number(plant, "friction.coulomb") / side,
        offset=-number(plant, "disturbance.offset") / side,
    )
    low, high = (numbers(values, f"dcarc.theta_{end}") for end in ("min", "max"))
    made: Values = {
        "dcarc.coil": number(plant, "solenoid.coil"),
        "dcarc.hysteresis": 0.5 * number(plant, "solenoid.hysteresis"),
        "dcarc.sides": min(abs(positive / negative - 1.0), 1.0),
        "dcarc.actuator_delay": number(plant, "solenoid.dead_time"),
        "dcarc.delay": number(plant, "lvdt.delay"),
        "dcarc.theta_initial": [
            min(max(w, least), most) for w, least, most in zip(weights, low, high, strict=True)
        ],
    }
    if number(plant, "friction.presliding") > 0.0:
        made["dcarc.presliding"] = [share * number(plant, "friction.presliding") for share in PRESLIDINGS]
    return made


def starts(values: Values, scale: Scale) -> list[Values]:
    """Gains to begin a search with, on a valve of this ``scale``; none with two more poles than zeros."""
    if _smoothing(values) == 0.0:
        return []
    close = max(LEAST, RUBBING * Weights(*numbers(values, "dcarc.theta_initial")).bristle2)
    common: Values = {
        "dcarc.input_noise": INPUT_NOISE,
        "dcarc.fit_noise": FIT_NOISE,
        "dcarc.forgetting": FORGETTING,
        "dcarc.theta_spread": [OTHERS[0], *([close] * 4), *OTHERS[1:]],
    }
    return [
        {**common, "dcarc.voltage_weight": weight * scale.gain**2, "dcarc.disturbance_rate": rate}
        for weight, rate in LOOPS
    ]


LAW = Law(
    name="dcarc",
    text="desired compensation, Kalman observer and LQR",
    module=sys.modules[__name__],
    parameters=PARAMETERS,
    build=build,
    model=model,
    sampled_model=sampled_model,
    form=tuple(f"dcarc.{name}" for name in FORM),
    dead_time="dcarc.delay",
    linear=without_adaptation,
    free=(
        Free("dcarc.disturbance_rate", 0.5, 60.0),
        Free("dcarc.input_noise", 0.05, 10.0),
        Free("dcarc.voltage_weight", 1e-3, 3.0, powers=(0, 2)),
        Free("dcarc.fit_noise", 0.1, 10.0),
        Free("dcarc.forgetting", 0.003, 3.0, powers=(1, 0)),
        Free(
            "dcarc.presliding[0]",
            0.002,
            0.05,
            followers=(("dcarc.presliding[1]", 2.5), ("dcarc.presliding[2]", 6.25)),
        ),
        Free("dcarc.standstill_rate", 0.03, 3.0),
        Free("dcarc.theta_spread[0]", 0.005, 0.6),
        Free(
            "dcarc.theta_spread[1]",
            0.01,
            3.0,
            followers=(("dcarc.theta_spread[2]", 1.0), ("dcarc.theta_spread[3]", 1.0)),
        ),
        Free("dcarc.theta_spread[4]", 0.01, 3.0),
        Free("dcarc.theta_spread[5]", 0.01, 3.0),
        Free("dcarc.theta_spread[6]", 0.01, 3.0),
        Free("dcarc.theta_spread[7]", 1e-6, 0.03, powers=(-1, -1)),
        Free("dcarc.theta_spread[8]", 1e-6, 3e-4, powers=(-2, -1)),
    ),
    lag=lag,
    of_model=of_model,
    of_plant=of_plant,
    starts=starts,
    remedy="shorten sample_period, or raise dcarc.voltage_weight or lower dcarc.disturbance_rate",
)
