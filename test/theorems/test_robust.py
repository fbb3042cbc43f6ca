# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Theorems 1 A and 2 A on a few random valves; the whole experiment is `make theorems`."""

import numpy as np
import pytest

from research.theorems import robust
from valve_control.control.laws.projection import Theta

VALVES = 60


@pytest.fixture(scope="module")
def experiment():
    return robust.experiment(VALVES, 3, ["arc", "oarc"], [1e-3, 1e-4, 5e-5, 2e-5])


def rows(law, period, change, valves=VALVES):
    loop = robust.loop_for(law)
    out = []
    for number in range(valves):
        case = change(robust.draw(3, number))
        p, s, x1, x2 = robust.LAWS[law].case(case, period)
        valve = robust.valve_of(case, period)
        out.append(loop(p, s, case.motion, valve, robust.Spool(x1, x2), round(0.2 / period)))
    return np.array(out)


@pytest.mark.parametrize("law", ["arc", "oarc"])
@pytest.mark.parametrize("period", [1e-4, 5e-5, 2e-5])
def test_no_valve_is_above_its_bound_at_short_sample_periods(experiment, law, period):
    cell = experiment.cell(law, period)
    assert cell.breaches == 0
    assert np.mean(cell.saturated) < 0.1
    assert robust.largest(cell.settled) > 0.3  # the bound is not so wide that nothing could reach it


def test_arc_breaks_at_1_ms_only_where_the_robust_gain_is_too_high_for_it(experiment):
    cell = experiment.cell("arc", 1e-3)
    late = cell.settled > 1.0
    assert np.sum(late) >= 3
    assert np.all(cell.loop_gain[late] > 2.0)  # a held gain g turns z2 into (1 - g·ΔT)·z2


@pytest.mark.parametrize("law", ["arc", "oarc"])
def test_sampling_error_is_of_order_of_the_period(experiment, law):
    assert 0.85 < experiment.scaling(law).order < 1.25


@pytest.mark.parametrize("law", ["arc", "oarc"])
def test_valves_outside_their_ranges_do_break_the_bound(law):
    """Eight spans beyond the assumed ranges, which the law does not know."""

    def outside(case):
        away = [t + 8.0 * (hi - lo) for t, lo, hi in zip(case.truth, case.lower, case.upper, strict=True)]
        return case._replace(truth=Theta(*away))

    result = rows(law, 1e-4, outside, 20)
    assert np.mean(result[:, 0] > 1.0) > 0.3


def test_a_disturbance_beyond_its_bound_does_break_it():
    loop = robust.loop_for("arc")
    above = 0
    for number in range(20):
        case = robust.draw(3, number)
        p, s, x1, x2 = robust.LAWS["arc"].case(case, 1e-4)
        valve = robust.valve_of(case, 1e-4)._replace(push=case.push._replace(kind=2.0, size=2000.0))
        above += loop(p, s, case.motion, valve, robust.Spool(x1, x2), 2000).ratio > 1.0
    assert above > 5


@pytest.mark.parametrize("law", robust.LAWS)
def test_compiled_and_plain_loops_give_the_same_bits(law):
    """Also that numba's cache did not hand out the loop of another law."""
    case = robust.draw(3, 4)
    p, s, x1, x2 = robust.LAWS[law].case(case, 1e-3)
    args = (p, s, case.motion, robust.valve_of(case, 1e-3), robust.Spool(x1, x2), 100)
    results = [np.array(robust.loop_for(law, compiled)(*args)) for compiled in (True, False)]
    assert np.array_equal(*results, equal_nan=True)


def test_disturbances_keep_to_their_bound():
    for number in range(30):
        case = robust.draw(5, number)
        values = [
            robust.disturbance(case.push, case.levels, t, side)
            for t in np.linspace(0.0, 0.4, 500)
            for side in (-1.0, 1.0)
        ]
        assert np.max(np.abs(values)) <= case.push.size
