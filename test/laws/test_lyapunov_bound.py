# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The bound on V2 solves its equation, holds inside the assumed ranges and breaks outside."""

import math

import numpy as np
import pytest
import scipy.integrate
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.laws import lyapunov_bound

PERIOD = 1e-4  # s; the theorems are of continuous time
SPREAD = 0.05  # of the assumed ranges around the nominal θ
NOMINAL = np.array([20.0, 1200.0, 1200.0, 0.0])
BOUNDS = {
    ("arc", "none"): {"arc.disturbance_bound": 1.0},
    ("arc", "quadratic"): {"arc.disturbance_bound": 1.0, "arc.epsilon": 1e4},
    ("oarc", "none"): {"oarc.disturbance_bound": 1e-3},
    ("oarc", "quadratic"): {"oarc.disturbance_bound": 1e-3, "oarc.epsilon1": 0.05, "oarc.epsilon2": 50.0},
}


@given(st.floats(0.1, 1000.0), st.floats(1e-5, 0.1), st.floats(0.0, 1e6), st.floats(0.0, 1e6))
def test_bound_solves_its_differential_equation(rate, period, start, growth):
    p = lyapunov_bound.design(rate, period)
    got = lyapunov_bound.advance(p, start, growth, True)
    exact = growth / rate + (start - growth / rate) * math.exp(-rate * period)
    assert got == pytest.approx(exact, rel=1e-9, abs=1e-9)
    numeric = scipy.integrate.solve_ivp(
        lambda t, b: -rate * b + growth, (0.0, period), [start], rtol=1e-9, atol=1e-9
    ).y[0, -1]
    assert got == pytest.approx(numeric, rel=1e-5, abs=1e-5)


def test_v2_is_never_below_zero_and_its_bound_neither():
    """z1 = 1 V falls by ż1 = -1000 V/s: (5) takes more than there is of a bound that was small."""
    p = lyapunov_bound.design(240.0, 0.001)
    before = lyapunov_bound.Sample(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    after = before._replace(z1=0.5, rate=-1000.0)
    assert lyapunov_bound.output_feedback(p, before, after, 1.0, 0.0).bound == 0.0
    rising = lyapunov_bound.output_feedback(p, before, after._replace(rate=1000.0), 1.0, 0.0)
    assert rising.bound > 0.0


def test_bound_waits_until_the_velocity_filter_has_forgotten_another_voltage():
    p = lyapunov_bound.design(240.0, 0.001, memory=0.002)
    bound = lyapunov_bound.wait(p, 5.0, 5.0, 1.0, False)
    for sample in range(4):
        assert lyapunov_bound.begin(bound, 7.0 + sample) == 7.0 + sample
        bound = lyapunov_bound.wait(p, bound, 7.0 + sample, 1.0, True)
    assert bound == lyapunov_bound.ANEW
    assert lyapunov_bound.wait(p, bound, 9.0, 1.0, True) == lyapunov_bound.advance(p, 9.0, 1.0, True)


def ratios(simulate, law, robust, truth, offset=0.0, gain=1.0, period=PERIOD):
    """Largest V2 over its bound on a valve with the parameters ``truth``."""
    lower, upper = NOMINAL * (1.0 - SPREAD), NOMINAL * (1.0 + SPREAD)
    lower[3], upper[3] = -1200.0 * SPREAD, 1200.0 * SPREAD
    time = np.arange(0.0, 0.6, period)
    command = 2.9 * np.sin(2.0 * math.pi * 2.0 * np.maximum(time - 0.05, 0.0))
    changes = {
        f"{law}.theta_min": lower.tolist(),
        f"{law}.theta_max": upper.tolist(),
        f"{law}.robust_term": robust,
        "arc.velocity_cutoff": 2000.0,
        **BOUNDS[law, robust],
    }
    run = simulate(
        law,
        command,
        period=period,
        valve={
            "valve": "custom",
            "numerator": [float(truth[2] * gain)],
            "denominator": [1.0, float(truth[0]), float(truth[1])],
            "disturbance.offset": float(truth[3] / truth[2]) + offset,
        },
        **changes,
    )
    v2, bound = run.terms["lyapunov"], run.terms["lyapunov_bound"]
    assert np.all(bound >= 0.0)
    return float(np.max(v2[bound > 0.0] / bound[bound > 0.0]))


@pytest.mark.parametrize(
    ("law", "robust", "period"), [*((*bound, PERIOD) for bound in BOUNDS), ("oarc", "none", 1e-3)]
)
def test_v2_stays_below_its_bound_inside_the_assumed_ranges(simulate, law, robust, period):
    """(25) and (52) on 15 random valves, with and without robust term.

    At 1 ms each of OARC's valves breaks the bound of continuous time, by 17 times, and not that in samples.
    """
    rng = np.random.default_rng(5 if period == PERIOD else 6)
    span = np.where(NOMINAL > 0.0, NOMINAL, 1200.0) * SPREAD
    for _ in range(15):
        truth = rng.uniform(NOMINAL - span, NOMINAL + span)
        assert ratios(simulate, law, robust, truth, period=period) < 1.0


@pytest.mark.parametrize(("law", "robust"), BOUNDS)
@pytest.mark.parametrize("outside", [{"offset": 3.0}, {"gain": 0.5}], ids=["disturbance", "gain"])
def test_v2_leaves_its_bound_outside_the_assumed_ranges(simulate, law, robust, outside):
    assert ratios(simulate, law, robust, NOMINAL, **outside) > 1.0
