# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Stability of dcarc's loop over boxes of valves: the matrices, the small-gain bound, what breaks it."""

import numpy as np
import pytest

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
            shown = dcarc.parts.past_dot(p.model.shown, estimate.past)
            corrected = dcarc.corrected(p, estimate, float(own.c[0] @ x) - shown)
            voltage = -dcarc.parts.dot(p.feedback, corrected.state) - corrected.disturbance
            estimate = dcarc.predicted(p, corrected, voltage, 0.0)
            seen[k] = corrected.disturbance
            x = own.a[0] @ x + own.b[0] * (voltage + (rotation**k).real)
        late = np.arange(2000, 3000)  # whole cycles
        found = 2.0 * np.mean(seen[late] * np.conj(rotation**late))
        assert found == pytest.approx(expected, rel=1e-6)
