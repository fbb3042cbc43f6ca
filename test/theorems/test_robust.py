# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Theorems 1 A and 2 A on a few random valves; the whole experiment is `make theorems`."""

import numpy as np
import pytest

from research.theorems import robust, tables
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


def test_runs_that_saturate_at_once_count_as_not_checked(experiment):
    """They must neither be among the runs below the bound nor hide how near to it the others come."""
    cell = experiment.cell("oarc", 1e-4)
    unknown = np.isnan(cell.ratio)
    assert 0 < np.sum(unknown) == cell.saturated_at_start < 0.1 * VALVES
    assert np.all(cell.saturated[unknown] == 1.0)
    for values in (cell.settled, cell.time, cell.excess, cell.loop_gain):
        assert np.all(np.isnan(values[unknown])) and np.all(np.isfinite(values[~unknown]))
    assert (cell.checked, cell.checked_later, cell.saturated_later) == (np.sum(~unknown), cell.checked, 0)
    assert cell.quantile(0.0) == np.min(cell.ratio[~unknown]) > 0.0
    data = next(
        c for c in tables.robust_data(experiment)["cells"] if (c["law"], c["period"]) == ("oarc", 1e-4)
    )
    assert data["excess_worst"] == np.max(cell.excess[~unknown]) < 0.0
    assert (data["saturated_at_start"], data["checked"]) == (cell.saturated_at_start, cell.checked)


def test_percentages_are_of_the_checked_runs():
    """Five runs: one saturates at once, one is above its bound and saturates before it is settled."""
    nan = np.nan
    ratio, settled = np.array([nan, 1.5, 0.5, 1.2, 0.6]), np.array([nan, nan, 0.4, 1.1, 0.2])
    saturated = np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    known = np.array([nan, 1.0, 1.0, 1.0, 1.0])
    cell = robust.Cell("oarc", 1e-3, *np.ones((2, 5)), ratio, settled, known, known, known, known, saturated)
    experiment = robust.Experiment(1, 5, 0.4, (cell,))
    line = next(line for line in tables.robust_lines(experiment) if line.startswith("OARC  "))
    assert line.split()[2:6] == ["20.00", "50.00", "33.33", "25.00"]
    assert tables.robust_data(experiment)["cells"][0]["above_bound_then_saturated"] == 1


def test_runs_that_saturate_before_the_start_is_forgotten_have_no_later_ratio(experiment):
    cell = experiment.cell("arc", 1e-3)
    short = np.isfinite(cell.ratio) & np.isnan(cell.settled)
    assert np.all(cell.saturated[short] == 1.0)
    assert cell.checked_later == cell.checked - np.sum(short)


def test_a_study_whose_only_run_saturates_at_once_has_a_table():
    experiment = robust.experiment(1, 15, ["oarc"], [1e-3, 5e-4], 0.05)
    assert all(cell.saturated_at_start == 1 for cell in experiment.cells)
    assert np.isnan(experiment.scaling("oarc").order) and np.isnan(experiment.cells[0].worst)
    assert "nan" not in "\n".join(tables.robust_lines(experiment))


@pytest.mark.parametrize("law", robust.LAWS)
def test_compiled_and_plain_loops_give_the_same_bits(law):
    """Also that numba's cache did not hand out the loop of another law."""
    case = robust.draw(3, 4)
    p, s, x1, x2 = robust.LAWS[law].case(case, 1e-3)
    args = (p, s, case.motion, robust.valve_of(case, 1e-3), robust.Spool(x1, x2), 100)
    results = [np.array(robust.loop_for(law, compiled)(*args)) for compiled in (True, False)]
    assert np.array_equal(*results, equal_nan=True)


def test_cases_come_from_the_seed_alone():
    assert robust.draw(5, 7).truth == robust.draw(5, 7).truth
    assert robust.draw(5, 7).truth != robust.draw(6, 7).truth
    for number in range(50):
        case = robust.draw(5, number)
        assert all(lo <= t <= hi for lo, t, hi in zip(case.lower, case.truth, case.upper, strict=True))
        assert all(lo <= t <= hi for lo, t, hi in zip(case.lower, case.estimate, case.upper, strict=True))


def test_disturbances_keep_to_their_bound():
    for number in range(30):
        case = robust.draw(5, number)
        values = [
            robust.disturbance(case.push, case.levels, t, side)
            for t in np.linspace(0.0, 0.4, 500)
            for side in (-1.0, 1.0)
        ]
        assert np.max(np.abs(values)) <= case.push.size


def test_blocks_in_processes_come_back_in_order():
    seen = []
    alone = robust.experiment(4, 1, ["arc"], [1e-3], 0.01)
    both = robust.experiment(
        4, 1, ["arc"], [1e-3], 0.01, processes=2, progress=lambda done, n: seen.append((done, n))
    )
    assert np.array_equal(alone.cells[0].ratio, both.cells[0].ratio, equal_nan=True)
    assert seen == [(1, 1)]
