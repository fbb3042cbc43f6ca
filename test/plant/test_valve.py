# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import math

import changed
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.parameters import build
from valve_control.control.plant import registry, valve
from valve_control.control.plant.models import FOURTH_ORDER, MODELS


def made(**changes):
    return build.valve_params(changed.valve(**changes))


def run(p, voltages):
    s = valve.initial(p)
    out = []
    for voltage in voltages:
        out.append((s.x.x0, s.x.x1))
        s = valve.step(p, s, float(voltage))
    return np.array(out)


@pytest.mark.parametrize("name", MODELS)
def test_linear_part_equals_scipy_for_held_voltages(name):
    p = made(valve=name)
    u = np.random.default_rng(1).uniform(-10.0, 10.0, 400)
    model = MODELS[name]
    discrete = scipy.signal.cont2discrete(
        scipy.signal.tf2ss(model.numerator, model.denominator), p.period, method="zoh"
    )
    _, expected, _ = scipy.signal.dlsim(discrete, u)
    assert np.allclose(run(p, u)[:, 0], expected[:, 0], rtol=1e-7, atol=1e-8)


def test_static_gain_offset_and_flow_force():
    p = made(gain_scale=1.2, disturbance__offset=0.3, flow_force=0.4)
    final = run(p, [2.0] * 3000)[-1, 0]
    gain = 1.2 * FOURTH_ORDER.static_gain
    assert math.isclose(final, gain * 2.3 / (1.0 + gain * 0.4), rel_tol=1e-6)


@pytest.mark.parametrize("period", [1e-4, 1e-3, 5e-3])
def test_friction_only_ever_takes_energy(period):
    """Free motion with friction comes to rest at any period and never swings further than without."""
    valve_2 = {"valve": "second_order", "sample_period": period}
    u = np.where(np.arange(round(2.0 / period)) * period < 0.5, 5.0, 0.0)
    rubbed = run(made(**valve_2, friction__coulomb=1.0, friction__velocity_scale=0.01), u)
    free = run(made(**valve_2), u)
    assert np.max(rubbed[:, 0]) <= np.max(free[:, 0]) + 1e-9
    assert np.max(np.abs(rubbed[-10:, 1])) <= 0.01 * 1.001


def test_saturation_drift_and_lvdt():
    p = made(u_max=5.0)
    assert np.array_equal(run(p, [50.0] * 100), run(p, [5.0] * 100))
    drifting = run(made(drift__gain=0.1), [2.0] * 3000)[-1, 0]
    assert math.isclose(drifting, 2.0 * FOURTH_ORDER.static_gain * 1.3, rel_tol=0.01)
    for p in (made(drift__gain=-0.01), made(drift__gain=-0.01, valve="solenoid")):
        module = registry.plant_of(p).module
        s = module.initial(p)._replace(time=150.0)  # nothing is left of its gain
        assert module.step(p, s, 2.0).x[:2] == (0.0, 0.0)
    p = made(lvdt__resolution=0.01, lvdt__bias=0.123)
    assert math.isclose(valve.read(p, valve.initial(p), 0.0), 0.12)
    p = made(lvdt__noise=0.5)
    assert valve.read(p, valve.initial(p), 2.0) == 1.0


@pytest.mark.parametrize("delay", [0.001, 0.0025])
def test_lvdt_delay_is_that_of_a_shifted_response(delay):
    """Against the same valve at an eighth of the period; a straight line between samples is off by 1e-4 V."""
    p, fine = made(lvdt__delay=delay), made(sample_period=0.000125)
    s, exact = valve.initial(p), valve.initial(fine)
    readings, positions = [], []
    for k in range(1600):
        if k % 8 == 0:
            readings.append(valve.read(p, s, 0.0))
            s = valve.step(p, s, 3.0)
        positions.append(exact.x.x0)
        exact = valve.step(fine, exact, 3.0)
    late = round(delay / fine.period)
    shifted = np.concatenate([np.zeros(late), positions])[:1600:8]
    assert np.allclose(readings, shifted, atol=1e-6)


@given(
    bristle=st.floats(-1.0, 1.0),
    velocity=st.floats(-20.0, 20.0),
    free=st.floats(-50.0, 50.0),
    presliding=st.floats(1e-4, 1.0),
    period=st.sampled_from([1e-5, 1e-3, 1e-2]),
)
def test_bristles_solve_their_implicit_equation(bristle, velocity, free, presliding, period):
    d = made(friction__coulomb=1.2, friction__static_ratio=1.3, friction__presliding=presliding).disturbance
    mobility = 1.1
    level = valve.friction_level(d, velocity)
    rubbing, following = valve.friction(d, level, bristle, free, mobility, period)
    v = free - mobility * rubbing
    assert math.isclose(
        following, bristle + period / presliding * (v - abs(v) * following), rel_tol=1e-9, abs_tol=1e-9
    )
    assert abs(following) <= 1.0 and abs(rubbing) <= 1.2 * 1.3 * (1.0 + 1e-12)


def test_presliding_is_dahls_hysteresis():
    """Quasi-static, d = presliding: from rest z = 1 - exp(-x/d); back by s: z = -1 + (1 + z0)·exp(-s/d)."""
    p = made(friction__coulomb=1.0, friction__presliding=0.2)
    bristle, x, v = 0.0, 0.0, 0.5
    found = []
    for k in range(4000):
        v = 0.5 if k < 2000 else -0.5
        # a spool that a strong hand moves: friction cannot change its velocity
        _, bristle = valve.friction(p.disturbance, 1.0, bristle, v, 1e-12, p.period)
        x += v * p.period
        found.append((x, bristle))
    there, back = found[799], found[2399]
    assert math.isclose(there[1], -math.expm1(-there[0] / 0.2), rel_tol=2e-3)
    top, way = found[1999][1], found[1999][0] - back[0]
    assert math.isclose(back[1], -1.0 + (1.0 + top) * math.exp(-way / 0.2), abs_tol=2e-3)
