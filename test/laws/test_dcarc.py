# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""dcarc: inverse, Kalman filter and LQR against other derivations; fit, dead time, saturation, refusals."""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.signal
from changed import controller
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.analysis.indices import rms
from valve_control.control.laws import dcarc, dcarc_design, least_squares, reshaping
from valve_control.control.laws.least_squares import Weights
from valve_control.control.laws.signals import Start
from valve_control.control.linear import stability
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.parameter import ParameterError

PERIOD = 0.001
THIRD_ORDER = TransferFunction((250.0, 60000.0), (1.0, 120.0, 8000.0, 90000.0))
MODELS = [SECOND_ORDER, THIRD_ORDER, FOURTH_ORDER]
ORDERS = ["second", "third", "fourth"]


def times(model, numerator, denominator):
    """``model`` in series with another transfer function."""
    up, down = np.polymul(model.numerator, numerator), np.polymul(model.denominator, denominator)
    return TransferFunction(tuple(up.tolist()), tuple(down.tolist()))


def coil(time):
    """Force of a solenoid over its voltage."""
    return [1.0], [time, 1.0]


SLOW = times(TransferFunction((0.9 * 3198.0,), (1.0, 90.5, 3198.0)), *coil(0.004))  # 9 Hz
FAST_SPOOL = times(TransferFunction((0.9 * 48361.0,), (1.0, 307.9, 48361.0)), *coil(0.0015))  # 35 Hz
FIFTH_ORDER = times(FOURTH_ORDER, *coil(0.003))
FARTHER = [1.0, 500.0, 160000.0], [1.0, 600.0, 250000.0]
SIXTH_ORDER = times(FOURTH_ORDER, *FARTHER)
SIXTH_WITH_COIL = times(times(THIRD_ORDER, *FARTHER), *coil(0.002))
COILS = [SLOW, FAST_SPOOL, FIFTH_ORDER, SIXTH_ORDER, SIXTH_WITH_COIL]
COIL_NAMES = ["9Hz", "35Hz", "fifth", "sixth", "sixth_coil"]
REST = Start(0.0, 0.0, 0.0, 0.0, 0.0)
STILL = {"dcarc.theta_spread": [0.0] * 9}
NOISES = {"reading": 0.006, "input_noise": 0.5, "walk": 0.1}
FAST = {"reshaping.max_rate": 1e5, "reshaping.max_accel": 1e7}


def custom(model):
    return {
        "dcarc.model": "custom",
        "dcarc.numerator": list(model.numerator),
        "dcarc.denominator": list(model.denominator),
    }


def params(model=FOURTH_ORDER, **changes):
    return dcarc.build(controller(**custom(model), **changes))


def plant(model=FOURTH_ORDER, period=PERIOD, delay=0.0, **changes):
    made = valve.design(model, period, 10.0, 1.0, valve.NO_DISTURBANCE, IDEAL._replace(delay=delay / period))
    return made._replace(disturbance=made.disturbance._replace(**changes))


def runs(p, v, commands, noise=0.0, start=REST, stands=None):
    """Law and valve, sample by sample: positions, voltages, terms and the states of the law."""
    rng = np.random.default_rng(1)
    s, x = dcarc.initial(p, start), valve.initial(v) if stands is None else stands
    rows, states = [], []
    for command in commands:
        reading = valve.read(v, x, 0.0) + noise * float(rng.standard_normal())
        voltage, s, terms = dcarc.step(p, s, float(command), reading, 0.0)
        rows.append((x.x.x0, voltage))
        states.append((terms, s))
        x = valve.step(v, x, voltage)
    return np.array(rows), states


def sine(amplitude, frequency, samples, period=PERIOD):
    """A sine that swells within 0.2 s, and the command whose reshaped reference it is."""
    t = np.arange(samples + 2) * period
    swell = 0.5 - 0.5 * np.cos(math.pi * np.minimum(t / 0.2, 1.0))
    wanted = amplitude * swell * np.sin(2.0 * math.pi * frequency * t)
    p = reshaping.build(controller())
    rate = np.diff(wanted) / period
    accel = np.diff(rate) / period
    wn, damping = p.natural_frequency, p.damping
    command = wanted[:-2] + 2.0 * damping / wn * rate[:-1] + accel / (wn * wn)
    return wanted[:samples], command[:samples]


@pytest.mark.parametrize("model", MODELS + COILS, ids=ORDERS + COIL_NAMES)
def test_inverse_is_the_reciprocal_of_the_model_at_every_frequency(model):
    """r = exp(jωt): u_r must be r/G(jω) and the first two states of x_r r and dr/dt."""
    of = dcarc_design.inverted(model)
    m = len(of.rate)
    for frequency in (0.5, 5.0, 15.0, 60.0):
        s = 2j * math.pi * frequency
        given_r = s ** np.arange(len(model.denominator) - m)
        inner = np.linalg.solve(s * np.eye(m) - of.rate[:, :m], of.rate[:, m]) if m else np.zeros(0)
        whole = np.concatenate([inner, given_r])
        response = np.polyval(model.numerator, s) / np.polyval(model.denominator, s)
        assert of.voltage @ whole == pytest.approx(1.0 / response, rel=1e-9)
        a, b = valve.observability_form(model)
        scale = dcarc_design.scale_of(model)
        states = np.linalg.solve(s * np.eye(len(b)) - a * scale / scale[:, None], b / scale) / response
        assert np.allclose(of.state @ whole / scale, states, rtol=1e-8, atol=1e-8 * abs(states[0]))


@pytest.mark.parametrize("model", MODELS[1:] + COILS[2:], ids=ORDERS[1:] + COIL_NAMES[2:])
@pytest.mark.parametrize("time", [PERIOD, 0.5 * PERIOD])
def test_inner_states_move_as_the_differential_equation_says(model, time):
    of = dcarc_design.inverted(model)
    m = len(of.rate)
    move = dcarc_design._move(of.rate, time)
    begin, reference, rate = np.array([3e-7, -2e-5, 1e-3, 0.1])[:m], 0.7, 25.0

    def slope(t, inner):
        return of.rate[:, :m] @ inner + of.rate[:, m] * (reference + rate * t)

    exact = scipy.integrate.solve_ivp(slope, (0.0, time), begin, rtol=1e-11, atol=1e-18).y[:, -1]
    state = dcarc.parts.Inverse(*(float(v) for v in (*begin, 0.0, 0.0, 0.0, 0.0)[:4]))
    assert np.allclose(dcarc.parts.moved(move, state, reference, rate)[:m], exact, rtol=1e-7, atol=1e-15)


def last_of_riccati(a, g, h):
    """X after 2¹⁶ steps of X ← h + aᵀX(I + gX)⁻¹a from 0, by doubling (Anderson 1978)."""
    for _ in range(16):
        w = np.linalg.inv(np.eye(len(a)) + g @ h)
        a, g, h = a @ w @ a, g + a @ w @ g @ a.T, h + a.T @ h @ w @ a
    return h


@pytest.mark.parametrize(
    ("model", "delay"),
    [
        *((model, delay) for model in MODELS for delay in (0.0, 0.0004, 0.001, 0.0023, 0.004)),
        *zip(COILS, (0.0, 0.004, 0.0004, 0.0, 0.0023), strict=True),
    ],
)
def test_kalman_gain_is_where_the_riccati_recursion_ends(model, delay):
    """The stationary equation of the design against the time-varying filter after 65,536 samples."""
    o = dcarc_design.observed(model, PERIOD, delay, **NOISES)
    n = len(o.a)
    order = len(model.denominator) - 1
    scale = np.concatenate([100.0 ** np.arange(order), np.ones(n - order)])
    gain = dcarc_design.kalman(o, scale)
    p = last_of_riccati(o.a.T, np.outer(o.c, o.c) / o.reading, o.process)
    k = p @ o.c / (o.c @ p @ o.c + o.reading)
    assert np.allclose(gain / scale, k / scale, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    ("model", "weight"),
    [
        *((model, weight) for model in MODELS for weight in (1e-4, 0.005, 1.0)),
        *zip(COILS, (1e-4, 1.0, 0.005, 0.005, 0.005), strict=True),
    ],
)
def test_lqr_gain_is_where_the_backward_recursion_ends(model, weight):
    """Bellman's recursion of the finite horizon, and the cost of the closed loop by its Lyapunov equation."""
    o = dcarc_design.observed(model, PERIOD, 0.0, **NOISES)
    n = len(model.denominator) - 1
    a, b = o.a[:n, :n], o.b[:n]
    scale = 100.0 ** np.arange(n)
    gain = dcarc_design.regulator(a, b, weight, scale)
    q = np.zeros((n, n))
    q[0, 0] = 1.0
    s = last_of_riccati(a, np.outer(b, b) / weight, q)
    assert np.allclose(gain, b @ s @ a / (weight + b @ s @ b), rtol=1e-6)

    def cost(k):
        loop = (a - np.outer(b, k)) * scale / scale[:, None]
        priced = q + weight * np.outer(k * scale, k * scale)
        return scipy.linalg.solve_discrete_lyapunov(loop.T, priced)[0, 0]

    best = cost(gain)
    for i in range(n):
        for factor in (0.97, 1.03):
            other = gain.copy()
            other[i] *= factor
            assert cost(other) >= best * (1.0 - 1e-9)


@pytest.mark.parametrize("model", COILS, ids=COIL_NAMES)
def test_the_check_of_stability_has_the_poles_of_filter_and_regulator(model):
    """On its own model the loop has the poles of A - B·K and of A·(I - L·c): separation principle."""
    p = params(model, dcarc__voltage_weight=0.05)
    o = dcarc_design.observed(
        model, PERIOD, 0.0, math.hypot(0.0056, 0.0037 / math.sqrt(12.0)), 1.2, 6.0 * math.sqrt(PERIOD)
    )
    n = len(o.b) - 1
    gain = np.array([*p.kalman.state[:n], p.kalman.disturbance])
    scale = np.append(dcarc_design.scale_of(model), 1.0)
    observer = (o.a @ (np.eye(n + 1) - np.outer(gain, o.c))) * scale / scale[:, None]
    regulated = (o.a[:n, :n] - np.outer(o.b[:n], p.feedback[:n])) * scale[:n] / scale[:n, None]
    expected = max(np.max(np.abs(np.linalg.eigvals(m))) for m in (observer, regulated))
    found = stability.pole_of(dcarc.LAW, p, stability.believed(dcarc.LAW, p))
    assert abs(found) == pytest.approx(expected, abs=1e-5)


def test_friction_is_learned_and_the_error_falls():
    """Coulomb friction with presliding: with the bristles the error of a 5 Hz sine falls to a third."""
    wanted, command = sine(1.0, 5.0, 4000)
    rough = plant(coulomb=1.0, presliding=0.02)
    rows, states = runs(params(**FAST), rough, command, noise=0.005)
    errors = [rms((rows[:, 0] - wanted)[k : k + 1000]) for k in (0, 3000)]
    fixed, _ = runs(params(**FAST, **STILL), rough, command, noise=0.005)
    t = states[-1][1].theta
    assert errors[1] < errors[0] and errors[1] < rms((fixed[:, 0] - wanted)[3000:]) / 3.0
    assert 0.6 < t.bristle1 + t.bristle2 + t.bristle3 < 1.4


def test_weights_rest_in_saturation_and_while_the_reference_rests():
    _, states = runs(params(), plant(coulomb=0.5, presliding=0.02), np.full(600, 9.9))
    thetas = [s.theta for _, s in states]
    voltages = [terms.unsaturated_voltage for terms, _ in states]
    saturated = [i for i in range(1, 600) if abs(voltages[i]) > 10.0]
    assert len(saturated) > 20
    assert all(thetas[i] == thetas[i - 1] for i in saturated)
    assert any(thetas[i] != thetas[i - 1] for i in range(1, 600))
    _, still = runs(params(), plant(offset=0.5), np.zeros(500), noise=0.005)
    assert all(s.theta == params().theta_initial for _, s in still)
    assert still[-1][0].disturbance == pytest.approx(0.5, abs=0.15)


def test_one_weight_is_the_scalar_kalman_filter():
    """Alone, a weight and its variance follow the textbook's recursion for y = θ·x + noise."""
    rng = np.random.default_rng(3)
    noise, truth = 0.3, 0.7
    zero = [0.0] * 9
    low, high = Weights(*[-9.0] * 9), Weights(*[9.0] * 9)
    theta, variance = Weights(*zero), least_squares.product(*[Weights(0.0, 0.8, *zero[2:])] * 2)
    information, evidence = 1.0 / 0.64, 0.0
    for _ in range(50):
        x = float(rng.normal())
        y = truth * x + noise * float(rng.normal())
        regressor = Weights(1.0, x, *zero[2:])
        px = least_squares.product(variance, regressor)
        sharpness = 1.0 / (noise**2 + least_squares.dot(px, regressor))
        error = least_squares.dot(theta, regressor) - y
        theta = least_squares.moved(theta, px, error * sharpness, low, high)
        variance = least_squares.learned(variance, px, sharpness, 0.0, variance)
        information += x * x / noise**2
        evidence += x * y / noise**2
    assert theta.bristle1 == pytest.approx(evidence / information, rel=1e-9)
    assert variance.bristle1 == pytest.approx(1.0 / information, rel=1e-9)
    assert theta.gain == variance.gain == 0.0


@pytest.mark.parametrize("delay", [0.0005, 0.001, 0.0027])
def test_a_known_dead_time_costs_nothing_and_an_unknown_one_does(delay):
    """The observer gives the position of now; without the dead time in its model it is late."""
    wanted, command = sine(1.0, 8.0, 1500)
    v = plant(delay=delay)
    known, states = runs(params(dcarc__delay=delay, **STILL, **FAST), v, command)
    unknown, _ = runs(params(**STILL, **FAST), v, command)
    late = slice(300, None)
    seen = np.array([terms.position for terms, _ in states])
    assert rms(seen[late] - known[late, 0]) < 1e-3
    assert rms(known[late, 0] - wanted[late]) < 1e-3
    assert rms(unknown[late, 0] - wanted[late]) > 5.0 * rms(known[late, 0] - wanted[late])


@pytest.mark.parametrize("model", MODELS, ids=ORDERS)
@pytest.mark.parametrize("delay", [0.0, 0.0017])
def test_starts_without_a_bump_in_motion(model, delay):
    """Taken over at 20 V/s: the first voltage is the one before, and the motion goes on."""
    p = params(model, dcarc__delay=delay, **STILL)
    v, y = 20.0, 0.4
    voltage = p.standing.voltage * (y + v * delay) + p.moving.voltage * v + 0.3
    s = dcarc.initial(p, Start(y, voltage, y + v * delay, v, v))
    command = reshaping.steady_command(p.reshaping, y + v * delay, v)
    got, after, terms = dcarc.step(p, s, command, y, 0.0)
    assert got == pytest.approx(voltage + 0.5 * PERIOD * v * p.standing.voltage, abs=1e-6)
    assert terms.velocity == pytest.approx(v) and terms.innovation == pytest.approx(0.0, abs=1e-12)
    assert after.estimate.state.x0 == pytest.approx(y + v * delay + v * PERIOD, abs=1e-5)
    assert terms.disturbance == pytest.approx(-0.3)


NUMBERS = [p for p in dcarc.PARAMETERS if isinstance(p.default, float)]


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_any_parameters_are_refused_in_words_or_give_a_bounded_voltage(data):
    """Random numbers over the whole of their ranges, and a valve that saturates, rests and jumps."""
    changes = {}
    for parameter in NUMBERS:
        if data.draw(st.booleans()):
            low, high = max(parameter.low, 1e-9), parameter.high
            changes[parameter.name] = math.exp(data.draw(st.floats(math.log(low), math.log(high))))
            changes[parameter.name] = min(max(changes[parameter.name], parameter.low), parameter.high)
    changes["sample_period"] = data.draw(st.sampled_from([0.00025, 0.001, 0.004]))
    changes["dcarc.model"] = data.draw(st.sampled_from(["second_order", "fourth_order"]))
    try:
        p = dcarc.build(controller(**changes))
    except ParameterError as error:
        assert "dcarc" in str(error) and "\n" not in str(error)
        return
    s = dcarc.initial(p, Start(0.1, 0.5, 0.2, 3.0, -5.0))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    for k in range(150):
        command = 10.0 * float(np.sign(rng.normal())) if k % 30 < 15 else 0.0
        voltage, s, terms = dcarc.step(p, s, command, 10.0 * float(np.clip(rng.normal(), -1, 1)), 0.0)
        assert abs(voltage) <= p.u_max
        assert all(math.isfinite(term) for term in terms)
        for low, weight, high in zip(p.theta_min, s.theta, p.theta_max, strict=True):
            assert low <= weight <= high
        if k % 50 == 40:
            s = dcarc.hold(p, s, command, 0.0, voltage)


@pytest.mark.parametrize("hertz", [300.0, 1500.0])
def test_a_zero_beyond_the_samples_is_taken_out_of_an_identified_model(hertz):
    """The inverse of such a zero would ask for many times the voltage."""
    denominator, z = (1.0, 451.7, 55198.5, 2725358.0), 2.0 * math.pi * hertz
    model = TransferFunction((2295720.0 / z, 2295720.0), denominator)
    bare = dcarc.LAW.of_model(model, PERIOD)
    assert dcarc.LAW.of_model(bare, PERIOD) is bare
    assert np.allclose(bare.numerator, [2295720.0], rtol=1e-12) and bare.denominator == denominator
    slow = TransferFunction((2295720.0 / 1400.0, 2295720.0), denominator)
    assert dcarc_design.without_fast_zero(slow, PERIOD) is slow
