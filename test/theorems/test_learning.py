# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""How fast dcarc may learn, on a few random valves."""

import numpy as np
import pytest

from research.theorems import bench, learning, loop
from valve_control.control.laws import dcarc


@pytest.fixture(scope="module")
def experiment():
    return learning.experiment(12, 2, noises=(0.01, 1.0), duration=6.0)


def test_shipped_learning_helps_on_each_linear_valve(experiment):
    cell = experiment.cell("linear", 1.0)
    assert np.all(cell.ratio < 0.95) and np.median(cell.ratio) < 0.6
    assert cell.worse == cell.lost == 0


def test_the_compensation_keeps_to_its_bound_and_comes_near_it(experiment):
    """No run above it; with all weights at their bounds the step itself asks for most of it."""
    assert all(np.max(cell.compensation) < 1.0 for cell in experiment.cells)
    p = loop.params({"u_max": learning.U_MAX})._replace(reshaping=bench.unlimited(loop.PERIOD))
    bound = learning.compensation_bound(p, *learning.limits(learning.MOTION))
    most = p._replace(theta_initial=p.theta_max)
    _, plain = learning.run_valve(most, learning.plants("linear", 1, 1)[0], 0, 2000)
    assert 0.2 * bound < plain < bound


def test_the_inverse_stays_within_its_bound_on_the_worst_reference():
    """A reference that jumps between its limits as the impulse response asks comes up to the bound."""
    p = loop.params({})
    rng = np.random.default_rng(0)
    bound = learning.compensation_bound(
        p._replace(theta_min=p.theta_min._replace(gain=-1.0), theta_max=dcarc.NOTHING._replace(gain=1.0)),
        1.0, 0.0, 0.0,
    ) - sum(abs(v) for v in p.theta_min[1:7])  # fmt: skip
    inner = dcarc.Inverse(0.0, 0.0, 0.0, 0.0)
    peak = 0.0
    for _ in range(200):
        level = float(rng.choice([-1.0, 1.0]))
        at = dcarc.Course(level, 0.0, 0.0, 0.0)
        for _ in range(int(rng.integers(1, 40))):
            middle = dcarc.moved(p.half, inner, level, 0.0)
            peak = max(peak, abs(dcarc.combined(p.model_voltage, middle, at)))
            inner = dcarc.moved(p.full, inner, level, 0.0)
    assert 0.5 * bound < peak < bound
