# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Stability of dcarc's loop over boxes of valves: the matrices, the small-gain bound, what breaks it."""

import numpy as np
import pytest
import scipy.linalg

from research.theorems import loop
from valve_control.control.laws import dcarc
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.linear import stability
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL

VALVES = 150
NOMINAL = loop.Valves(*(np.array([v]) for v in (1.0, 1.0, 1.0, 0.0, 0.0)))


@pytest.fixture(scope="module")
def study():
    return loop.study(VALVES, 3)


@pytest.mark.parametrize("gains", loop.SHIPPED)
def test_poles_are_those_of_the_law_s_own_step(gains):
    """Matrices from the law's numbers against differences of single steps; whole dead times are exact."""
    p = loop.shipped()[gains]
    valves = loop.draw(4, 3, "wide", 1.0)._replace(delay=np.array([0.0, 1e-3, 2e-3]))
    found = loop.radii(loop.feedback(p), loop.sampled(valves), valves.gain)
    for i, radius in enumerate(found):
        plant = valve.design(
            loop.model(valves.poles[i], valves.zeros[i]),
            loop.PERIOD,
            10.0,
            float(valves.gain[i]),
            valve.FREE._replace(flow_force=float(valves.flow[i])),
            IDEAL._replace(delay=valves.delay[i] / loop.PERIOD),
        )
        assert radius == pytest.approx(abs(stability.dominant_pole(LAWS["dcarc"], p, plant)), abs=1e-9)


def test_the_weight_of_the_gain_is_a_factor_of_the_loop():
    """A law whose θ1 rests at 0.4 on a valve has the poles of the same law on one of 1.4 times the gain."""
    p = loop.params({})
    plant = valve.design(loop.model(1.1, 0.9), loop.PERIOD, 10.0, 0.8, valve.FREE, IDEAL)
    shifted = p._replace(theta_initial=p.theta_initial._replace(gain=0.4))
    valves = loop.Valves(*(np.array([v]) for v in (0.8, 1.1, 0.9, 0.0, 0.0)))
    found = loop.radii(loop.feedback(p), loop.sampled(valves), valves.gain * 1.4)[0]
    assert found == pytest.approx(abs(stability.dominant_pole(LAWS["dcarc"], shifted, plant)), abs=1e-9)


def test_no_valve_that_small_gain_proves_stable_has_a_pole_outside(study):
    for cell in study.cells:
        proven = cell.bound < 1.0
        assert np.all(cell.learned[proven] < 1.0)
        if cell.scale == 0.5:
            assert np.mean(proven) > 0.75


def test_what_the_observer_shows_of_a_disturbance_is_the_law_s_own_answer():
    """Frequency response of d̂ against the law's own predictor and corrector under a sine at the input."""
    p = loop.params({"dcarc.delay": 0.0007})
    own = loop.sampled(NOMINAL._replace(delay=np.array([0.0007])))
    for frequency in (3.0, 25.0):
        z = loop.circle(np.array([frequency]))
        expected = loop.shown_disturbance(loop.feedback(p), own, np.ones(1), z)[0, 0]
        n, rotation = 3000, z[0]
        x = np.zeros(own.b.shape[1])
        estimate = dcarc.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0)).estimate
        seen = np.zeros(n)
        for k in range(n):
            shown = dcarc.past_dot(p.model.shown, estimate.past)
            corrected = dcarc.corrected(p, estimate, float(own.c[0] @ x) - shown)
            voltage = -dcarc.dot(p.feedback, corrected.state) - corrected.disturbance
            estimate = dcarc.predicted(p, corrected, voltage, 0.0)
            seen[k] = corrected.disturbance
            x = own.a[0] @ x + own.b[0] * (voltage + (rotation**k).real)
        late = np.arange(2000, 3000)  # whole cycles
        found = 2.0 * np.mean(seen[late] * np.conj(rotation**late))
        assert found == pytest.approx(expected, rel=1e-6)


def test_the_regressor_is_as_late_as_the_observer_at_low_frequencies():
    """Both lags have the same mean delay: their phases differ by the third order of the frequency only."""
    p = loop.params({})
    slow = np.array([0.5, 1.0, 2.0])
    z = loop.circle(slow)
    shown = loop.shown_disturbance(loop.feedback(p), loop.sampled(NOMINAL), np.ones(1), z)[0]
    late = p.lag_share / (z - 1.0 + p.lag_share)
    difference = np.abs(np.angle(shown / late))
    assert difference[1] < 1e-3
    assert np.log2(difference[2] / difference[1]) == pytest.approx(3.0, abs=0.2)


def test_valves_are_sampled_as_the_matrix_exponential_says():
    valves = loop.draw(2, 2, "wide", 1.0)
    plants = loop.sampled(valves)
    for i in range(2):
        a, b = valve.realisation(loop.model(valves.poles[i], valves.zeros[i]))
        assert np.allclose(
            plants.a[i, :4, :4] + np.outer(plants.b[i, :4] * valves.gain[i] * valves.flow[i], np.eye(4)[0]),
            scipy.linalg.expm(a * loop.PERIOD),
        )
        assert loop.model(valves.poles[i], valves.zeros[i]).static_gain == pytest.approx(
            loop.model(1.0, 1.0).static_gain
        )
        assert np.max(np.abs(np.linalg.eigvals(a))) == pytest.approx(
            valves.poles[i] * np.max(np.abs(np.roots(loop.model(1.0, 1.0).denominator)))
        )
        assert b[1] > 0.0
