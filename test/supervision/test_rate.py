# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Readings of another rate: measured, reported, and off beyond what the gains were checked for."""

import changed
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import linear_loop
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.supervision import rate
from valve_control.control.supervision.memory import Mode
from valve_control.parameter import defaults, updated

PERIOD = 0.001
PARAMS = rate.Params(PERIOD, 0.15)


def after(times, p=PARAMS, numbers=None):
    """State after readings at ``times``."""
    numbers = range(len(times)) if numbers is None else numbers
    state = rate.UNKNOWN
    for k in range(1, len(times)):
        state = rate.step(p, state, times[k] - times[k - 1], numbers[k] - numbers[k - 1])
    return state


def feed(made, seconds, period, began=0):
    count = round(seconds / period)
    for k in range(count):
        made.command(0.0)
        made.sample(1e-4 * (k % 2), began + k, period)
    return began + count


@given(st.floats(0.4, 2.5), st.floats(0.0, 0.5), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_the_period_is_measured_whatever_jitter_and_loss(factor, share_lost, seed):
    random = np.random.default_rng(seed)
    kept = np.flatnonzero(random.random(4000) >= share_lost)
    times = factor * PERIOD * kept + 0.001 * random.random(len(kept))
    assert rate.measured(after(np.sort(times), numbers=kept)) == pytest.approx(factor * PERIOD, rel=0.011)


@pytest.mark.parametrize(
    ("level", "factors"),
    [(0, (1.0, 0.985, 1.015)), (1, (0.97, 1.03, 0.87, 1.13)), (2, (0.8, 1.2, 0.5, 2.0))],
)
def test_level(level, factors):
    assert {after(factor * PERIOD * np.arange(10000)).level for factor in factors} == {level}


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.2, 2.0])
def test_beyond_the_limit_the_voltage_is_off_until_the_period_is_right(factor):
    made = changed.supervisor(controller="arc")
    number = feed(made, 1.5, factor * PERIOD)
    assert made.mode is Mode.SAFE and made.voltage == 0.0
    assert f"every {factor:g} ms, sample_period is 1 ms" in made.reason
    number = feed(made, 5.0, factor * PERIOD, number)
    assert made.mode is Mode.SAFE and made.memory.counts["safe_stops"] == 1
    feed(made, 2.0, PERIOD, number)
    assert made.mode is Mode.OK


def with_standstills(pause, apart, count=12):
    """Times between readings: ``pause`` [s] in which nothing comes, and then at once all that is due."""
    due = round(pause / PERIOD)
    burst = np.full(due, 5e-5)
    stretch = np.concatenate([[pause + PERIOD], burst, [PERIOD - sum(burst)], np.full(apart, PERIOD)])
    return np.concatenate([np.full(2000, PERIOD), np.tile(stretch, count), np.full(1000, PERIOD)])


def run_as_a_node(made, steps, hold=0.0215):
    """What is reported with each of the readings; nothing for ``hold`` [s] is a silence."""
    reasons = []
    for k, elapsed in enumerate(steps):
        made.command(0.0)
        if elapsed > hold:
            made.silence(hold)
            elapsed -= hold
        made.sample(1e-4 * (k % 2), k, elapsed)
        reasons.append(made.reason)
    return reasons


@pytest.mark.parametrize("pause", [0.015, 0.023, 0.03])
@pytest.mark.parametrize("apart", [50, 100, 137, 200, 300])
def test_standstills_and_their_bursts_are_no_period(pause, apart):
    """Those of 23 ms were: up to 13 stops and 1.5 s of 0 V after twelve of them."""
    made = changed.supervisor(controller="arc")
    reasons = run_as_a_node(made, with_standstills(pause, apart))
    assert not any("come every" in reason for reason in reasons)
    assert made.memory.counts["safe_stops"] == (12 if pause > 0.0215 else 0)


@pytest.mark.parametrize("factor", [0.2, 0.5, 0.8, 1.2, 2.0, 10.0])
def test_a_wrong_period_is_known_before_a_first_voltage(factor):
    """And a right one after twenty readings, the first of which came at any time."""
    state = rate.interrupted(rate.UNKNOWN)
    for k in range(400):
        state = rate.step(PARAMS, state, factor * PERIOD if k else 0.07, 1)
        assert not rate.is_right(PARAMS, state)
    assert state.level == 2 and rate.measured(state) == pytest.approx(factor * PERIOD)
    state = rate.UNKNOWN
    for k in range(22):
        state = rate.step(PARAMS, state, PERIOD if k else 0.07, 1)
    assert rate.is_right(PARAMS, state)


def test_a_sample_period_that_the_readings_contradict_is_refused():
    made = changed.supervisor(controller="pid")
    assert made.period_refusal(0.002) == ""
    feed(made, 0.5, PERIOD)
    assert made.period_refusal(0.002) == (
        "sample_period cannot become 2 ms while LVDT readings come every 1 ms; "
        "change the period of the readings first"
    )
    assert made.period_refusal(PERIOD) == made.period_refusal(1.05 * PERIOD) == ""


@pytest.mark.parametrize("name", ["arc", "oarc", "pid", "pid_plain"])
def test_shipped_gains_are_stable_within_the_limit(name, config):
    """Poles of the loop around a valve whose period is another one than the law's."""
    values = updated(CONTROLLER, defaults(CONTROLLER), files.load(str(config / f"{name}.yaml"))["controller"])
    params = build.law_params(values)
    theta = (
        params.theta_initial[:3] if "theta_initial" in params._fields else (params.a1, params.a0, params.b0)
    )
    limit, plants = values["lvdt.period_limit"], []
    for factor in np.linspace(1.0 - limit, 1.0 + limit, 7).tolist():
        for gain in (1.0, 1.25):
            model = {"valve": "custom", "numerator": [gain * theta[2]], "denominator": [1.0, *theta[:2]]}
            plants.append(build.valve_params(changed.valve(**model, sample_period=factor * params.period)))
    law = linear_loop.linear_law(LAWS[values["controller"]], params)
    assert np.all(np.abs(linear_loop.dominant_poles(law, linear_loop.linear_valves(plants))) < 0.998)
