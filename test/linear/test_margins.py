# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Margins of the sampled loop and swings that friction sustains: closed forms, poles, runs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from research import comparison
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import friction_swing, linear_loop, margins
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, TransferFunction
from valve_control.control.plant.valve import NO_DISTURBANCE
from valve_control.control.simulation import batch
from valve_control.parameter import defaults, updated

PERIOD = 0.001
STRONG = {"dcarc.voltage_weight": 0.007, "dcarc.disturbance_rate": 6.7}
PLAIN = {"pid.form": "plain", "pid.kp": 10.0, "pid.ki": 300.0, "pid.kd": 0.07}
CASES = {
    "arc": ("arc", {}),
    "oarc": ("oarc", {}),
    "oarc with fast adaptation": ("oarc", {"oarc.gamma": [2.0, 110.0, 120.0, 5e4], "oarc.ks1": 60.0}),
    "dcarc": ("dcarc", STRONG),
    "dcarc that knows a dead time": ("dcarc", {"dcarc.delay": 0.0006, **STRONG}),
    "pid, paper": ("pid", {}),
    "pid, reference": ("pid", {**PLAIN, "pid.form": "reference"}),
    "pid, plain": ("pid", PLAIN),
}


def plant(gain=1.0, delay=0.0, model=FOURTH_ORDER):
    return valve.design(model, PERIOD, 10.0, gain, NO_DISTURBANCE, IDEAL._replace(delay=delay / PERIOD))


def law_of(name, changes):
    law = LAWS[name]
    return law, law.build(updated(CONTROLLER, defaults(CONTROLLER), changes))


def told(law, params, *plants):
    return margins.margins(law, params, margins.prepared(plants or (plant(),)))


def radius(law, params, plants):
    linear = linear_loop.linear_law(law, params)
    return np.abs(linear_loop.dominant_poles(linear, linear_loop.linear_valves(plants)))


@pytest.mark.parametrize("case", CASES)
def test_told_margins_are_those_of_the_poles(case):
    """Two derivations: response on the unit circle, and eigenvalues with more gain or dead time."""
    law, params = law_of(*CASES[case])
    base = 0.00037
    found = told(law, params, plant(delay=base))
    factor, delay = 10.0 ** (found.gain_db[0] / 20.0), found.delay_s[0]
    for share, stable in ((0.99, True), (1.01, False)):
        turned_up = [plant(factor * share, base), plant(1.0, base + share * delay)]
        assert np.all((radius(law, params, turned_up) < 1.0) == stable)


@given(kp=st.floats(0.5, 50.0), a1=st.floats(20.0, 150.0), w=st.floats(30.0, 300.0))
def test_gain_margin_of_a_proportional_loop_is_that_of_jury(kp, a1, w):
    """z² + c1·z + c0 + k·(b1·z + b0) is stable while c0 + k·b0 < 1 and its value at z = -1 is above 0."""
    model = TransferFunction((w * w,), (1.0, a1, w * w))
    law, params = law_of("pid", {**PLAIN, "pid.kp": kp, "pid.ki": 0.0, "pid.kd": 0.0})
    p = plant(model=model)
    a = np.array([p.row0[:2], p.row1[:2]])
    b = np.array(p.input[:2])
    c0, c1 = np.linalg.det(a), -np.trace(a)
    b1 = b[0]
    b0 = -(a[1, 1] * b[0] - a[0, 1] * b[1])
    limits = [(1.0 - c0) / b0]
    if b1 - b0 > 0.0:
        limits.append((1.0 - c1 + c0) / (b1 - b0))
    most = min(k for k in limits if k > 0.0)
    found = told(law, params, p)
    if kp < 0.98 * most:
        assert found.gain_db[0] == pytest.approx(20.0 * math.log10(most / kp), abs=0.05)
        assert math.isinf(found.reduction_db[0])
    elif kp > most * 1.0001:
        assert (found.gain_db[0], found.phase_deg[0], found.delay_s[0]) == (0.0, 0.0, 0.0)


def test_peaks_bound_the_margins():
    """With the peak M of the sensitivity: gain margin ≥ M/(M - 1), phase margin ≥ 2·asin(1/(2M))."""
    for case in CASES.values():
        law, params = law_of(*case)
        plants = [plant(gain, delay) for gain in (0.7, 1.0, 1.3) for delay in (0.0, 0.0004, 0.001)]
        found = told(law, params, *plants)
        stable = np.isfinite(found.sensitivity_db)
        m = 10.0 ** (found.sensitivity_db[stable] / 20.0)
        assert np.count_nonzero(stable) >= 3
        assert np.all(10.0 ** (found.gain_db[stable] / 20.0) >= 0.99 * m / (m - 1.0))
        assert np.all(found.phase_deg[stable] >= 0.99 * np.degrees(2.0 * np.arcsin(0.5 / m)))
        one = margins.worst(found)
        assert one.gain_db[0] == np.min(found.gain_db) and one.sensitivity_db[0] == np.max(
            found.sensitivity_db
        )


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("delay", [0.0, 0.0023])
def test_the_linear_valve_moves_as_the_simulated_one(order, delay):
    model = FOURTH_ORDER if order == 4 else TransferFunction((1502.0,), (1.0, 58.8, 1657.0))
    p = plant(1.3, delay, model)
    p = p._replace(disturbance=NO_DISTURBANCE._replace(flow_force=0.2))
    linear = linear_loop.linear_valves([p])
    x, before, shown = np.zeros(4), np.zeros(4), [0.0] * (int(linear.late[0]) + 1)
    s = valve.initial(p)
    for k in range(60):
        shown.append(linear.now[0] @ x + linear.before[0] @ before)
        assert shown[-1 - int(linear.late[0])] == pytest.approx(valve.read(p, s, 0.0), rel=1e-9, abs=1e-15)
        voltage = math.sin(0.3 * k)
        x, before = linear.a[0] @ x + linear.b[0] * voltage, x
        s = valve.step(p, s, voltage)


PERIOD = 0.001
RUBBING = NO_DISTURBANCE._replace(coulomb=1.0, presliding=1.0)
GAINS = "config/tuned/wide_0.25_pid_reference.yaml"


def first_harmonic(deflection, samples):
    """Of the bristles that ``valve.friction`` moves, over x = deflection·sin; ``samples`` in a cycle."""
    omega = 2.0 * math.pi / samples  # per period of 1 s
    z, force = 0.0, np.empty(samples)
    for k in range(4 * samples):
        velocity = deflection * omega * math.cos(omega * (k + 1))
        level, z = valve.friction(RUBBING, 1.0, z, velocity, 0.0, 1.0)
        force[k % samples] = level
    wave = np.exp(-1j * omega * np.arange(samples))
    return complex(2.0 / samples * np.sum(force * wave)) / (-1j * deflection)


@given(st.floats(-2.0, 1.5))
def test_describing_function_is_the_first_harmonic_of_the_bristles(exponent):
    deflection = 10.0**exponent
    found = complex(friction_swing.describing_function(np.array([deflection]))[0])
    assert first_harmonic(deflection, 4000) == pytest.approx(found, rel=0.01, abs=1e-5)


@pytest.mark.parametrize("frequency", [10.0, 30.0, 60.0])
@pytest.mark.parametrize("deflection", [0.2, 1.0])
def test_sampled_bristles_are_ahead_by_one_and_a_half_periods(frequency, deflection):
    samples = round(1.0 / (PERIOD * frequency))
    sampled = first_harmonic(deflection, samples)
    found = complex(friction_swing.describing_function(np.array([deflection]))[0])
    ahead = np.angle(sampled / found) * samples / (2.0 * math.pi)
    assert ahead == pytest.approx(friction_swing.AHEAD, abs=0.2)


def swings(law, params, plants):
    """Predicted amplitudes [V] of the swings in the loop, the valves' own included."""
    box = margins.prepared(plants)
    loop = -linear_loop.law_response(linear_loop.linear_law(law, params), box.z) * box.response
    return friction_swing.swings(loop, box.position, box.z, box.coulomb, box.presliding)


def rubbing(coulomb, presliding, delay=0.0005):
    """A valve on which the swings of GAINS were seen: slow poles, fast zeros, much gain."""
    friction = NO_DISTURBANCE._replace(coulomb=coulomb, presliding=presliding, flow_force=0.3)
    made = comparison.made_of(1.35, 0.8, 1.22, delay, friction)
    return made._replace(lvdt=made.lvdt._replace(noise=0.0, resolution=0.0))


@pytest.mark.parametrize(
    ("coulomb", "presliding", "delay"), [(1.4, 0.035, 0.0005), (1.0, 0.03, 0.0), (1.0, 0.035, 0.0015)]
)
def test_predicted_swing_is_that_of_a_run(coulomb, presliding, delay):
    """The largest over the levels of friction up to the valve's own, after a step."""
    values = files.load(GAINS)["controller"]
    law = LAWS["pid"]
    params = law.build(updated(CONTROLLER, defaults(CONTROLLER), values))
    plants = [rubbing(share * coulomb, presliding, delay) for share in np.linspace(0.1, 1.0, 19)]
    predicted = swings(law, params, plants[-1:])[0]
    command = np.where(np.arange(6000) < 100, 0.0, 0.3)
    traces = np.empty((len(plants), len(command), 3))
    seeds = np.ones(len(plants), dtype=int)
    batch.simulate(batch.Batch(law.name, params, batch.records(plants), seeds, command), 1, traces)
    last = traces[:, -2000:, 0]
    amplitude = math.sqrt(2.0) * np.max(np.std(last, axis=1))
    assert predicted > 0.04
    assert amplitude == pytest.approx(predicted, rel=0.15)


def test_the_valves_own_swing_is_no_limit_cycle_of_the_loop():
    """The loop makes the swing of the valve little larger, above what counts as rest; margins say so too."""
    values = updated(CONTROLLER, defaults(CONTROLLER), files.load(GAINS)["controller"])
    law = LAWS["pid"]
    params = law.build(values)
    plants = [rubbing(1.4, 0.035), rubbing(1.4, 0.035)._replace(gain_scale=4.0)]
    box = margins.prepared(plants[:1])
    whole = swings(law, params, plants[:1])[0]
    assert box.own_swing[0] < whole < margins.GROWN * box.own_swing[0]
    assert margins.margins(law, params, box).swing_v[0] == pytest.approx(
        whole * (whole / box.own_swing[0] - 1.0) / (margins.GROWN - 1.0)
    )
