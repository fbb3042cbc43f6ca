# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Theorems 1 and 2, A and B, and dcarc's loop on random valves; the whole experiments are `make theorems`."""

import numpy as np
import pytest

from research.theorems import adaptive, loop, robust
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import stability
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL


@pytest.fixture(scope="module")
def experiment():
    return adaptive.experiment(3, 2, periods=[5e-4, 2.5e-4, 1e-4], duration=12.0)


@pytest.mark.parametrize("law", adaptive.LAWS)
def test_at_rest_the_error_vanishes_to_rounding_and_the_estimates_do_not(experiment, law):
    cell = experiment.cell(law, "rest", 1e-4)
    assert cell.first > 1e-3
    assert cell.residual < 1e-12
    assert cell.estimate_error > 0.9


@pytest.mark.parametrize("law", adaptive.LAWS)
def test_what_is_left_in_motion_is_of_the_order_of_the_period(experiment, law):
    assert 0.8 < experiment.order(law, "three sines").order < 1.4
    cell = experiment.cell(law, "three sines", 1e-4)
    assert cell.residual < 0.1 * cell.first
    assert np.all(cell.saturated == 0.0)


@pytest.mark.parametrize("law", adaptive.LAWS)
def test_estimates_converge_only_under_persistent_excitation(experiment, law):
    assert experiment.cell(law, "three sines", 1e-4).estimate_error < 0.1
    assert experiment.cell(law, "one sine", 1e-4).estimate_error > 0.5


@pytest.fixture(scope="module")
def robust_experiment():
    return robust.experiment(60, 3, ["arc", "oarc"], [1e-3, 1e-4, 5e-5, 2e-5])


@pytest.mark.parametrize("law", ["arc", "oarc"])
@pytest.mark.parametrize("period", [1e-4, 5e-5, 2e-5])
def test_no_valve_is_above_its_bound_at_short_sample_periods(robust_experiment, law, period):
    cell = robust_experiment.cell(law, period)
    assert cell.breaches == 0
    assert np.mean(cell.saturated) < 0.1
    assert robust.largest(cell.settled) > 0.3  # the bound is not so wide that nothing could reach it


@pytest.mark.parametrize("law", ["arc", "oarc"])
def test_sampling_error_is_of_order_of_the_period(robust_experiment, law):
    assert 0.85 < robust_experiment.scaling(law).order < 1.25


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
            valve.NO_DISTURBANCE._replace(flow_force=float(valves.flow[i])),
            IDEAL._replace(delay=valves.delay[i] / loop.PERIOD),
        )
        assert radius == pytest.approx(abs(stability.dominant_pole(LAWS["dcarc"], p, plant)), abs=1e-9)


def test_no_valve_that_small_gain_proves_stable_has_a_pole_outside(study):
    for cell in study.cells:
        proven = cell.bound < 1.0
        assert np.all(cell.learned[proven] < 1.0)
        if cell.scale == 0.5:
            assert np.mean(proven) > 0.75
