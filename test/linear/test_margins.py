# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Margins of the sampled loop: against closed forms, the loop's poles, and loops that break."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import linear_loop, margins
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.models import FOURTH_ORDER, TransferFunction
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.valve import FREE
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
    return valve.design(model, PERIOD, 10.0, gain, FREE, IDEAL._replace(delay=delay / PERIOD))


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
    p = p._replace(disturbance=FREE._replace(flow_force=0.2))
    linear = linear_loop.linear_valves([p])
    x, before, shown = np.zeros(4), np.zeros(4), [0.0] * (int(linear.late[0]) + 1)
    s = valve.initial(p)
    for k in range(60):
        shown.append(linear.now[0] @ x + linear.before[0] @ before)
        assert shown[-1 - int(linear.late[0])] == pytest.approx(valve.read(p, s, 0.0), rel=1e-9, abs=1e-15)
        voltage = math.sin(0.3 * k)
        x, before = linear.a[0] @ x + linear.b[0] * voltage, x
        s = valve.step(p, s, voltage)
