# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Theorems 1 A and 2 A on a few random valves; the whole experiment is `make theorems`."""

import numpy as np
import pytest

from research.theorems import robust

VALVES = 60


@pytest.fixture(scope="module")
def experiment():
    return robust.experiment(VALVES, 3, ["arc", "oarc"], [1e-3, 1e-4, 5e-5, 2e-5])


@pytest.mark.parametrize("law", ["arc", "oarc"])
@pytest.mark.parametrize("period", [1e-4, 5e-5, 2e-5])
def test_no_valve_is_above_its_bound_at_short_sample_periods(experiment, law, period):
    cell = experiment.cell(law, period)
    assert cell.breaches == 0
    assert np.mean(cell.saturated) < 0.1
    assert robust.largest(cell.settled) > 0.3  # the bound is not so wide that nothing could reach it


@pytest.mark.parametrize("law", ["arc", "oarc"])
def test_sampling_error_is_of_order_of_the_period(experiment, law):
    assert 0.85 < experiment.scaling(law).order < 1.25
