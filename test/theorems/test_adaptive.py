# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Theorems 1 B and 2 B on a few random valves."""

import numpy as np
import pytest

from research.theorems import adaptive


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
