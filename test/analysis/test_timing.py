# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from valve_control.control.analysis.timing import lost_messages, timing, true_period


def test_a_regular_topic_has_nothing_to_report():
    t = timing(np.arange(1001) * 1_000_000, np.arange(1001) + 5)
    assert t.messages == 1001 and t.gaps == 0 and t.lost == 0
    assert t.rate_hz == pytest.approx(1000.0) and t.period_s == pytest.approx(1e-3)
    assert t.jitter_s.max == pytest.approx(0.0, abs=1e-15)


def test_gaps_jitter_and_losses_are_those_put_in():
    time = np.arange(2000) * 1_000_000
    keep = np.ones(2000, dtype=bool)
    keep[[100, 101, 500]] = False
    time[900] += 300_000  # one message 0.3 ms late: two intervals off by that
    t = timing(time[keep], np.arange(2000)[keep] + 1)
    assert t.gaps == 2 and t.lost == 3
    assert t.longest_gap_s == pytest.approx(3e-3)
    assert t.jitter_s.max == pytest.approx(2e-3) and t.jitter_s.p50 == pytest.approx(0.0, abs=1e-12)


def test_losses_are_unknown_without_numbers_and_survive_a_restart():
    assert lost_messages(np.zeros(50, dtype=np.int64)) is None
    assert lost_messages(np.array([7, 8, 9, 1, 2, 5])) == 2


def readings(count=20_000, period=1e-3, seed=1, jitter=0.0, lost=0.0, pauses=0, numbered=True, burst=1):
    """Times [ns] and numbers of readings, of which a pause takes time but no number."""
    random = np.random.default_rng(seed)
    number = np.arange(count)
    time = number * period
    for begin in random.integers(0, count, pauses):
        time[begin:] += random.uniform(0.01, 2.0)
    time = np.maximum.accumulate(time + np.abs(random.normal(0.0, jitter, count)))
    if burst > 1:  # delivered some at a time
        time = time[np.minimum(number // burst * burst + burst - 1, count - 1)] + number % burst * 1e-6
    kept = random.random(count) >= lost
    return np.round(time * 1e9).astype(np.int64)[kept], number[kept] * numbered


HARD = [
    {},
    {"jitter": 5e-4},
    {"jitter": 2e-3},
    {"lost": 0.3},
    {"pauses": 20},
    {"jitter": 5e-4, "lost": 0.1, "pauses": 20},
    {"numbered": False},
    {"numbered": False, "lost": 0.1},
    {"numbered": False, "lost": 0.1, "jitter": 1e-4},
    {"numbered": False, "pauses": 20},
    {"numbered": False, "burst": 10},
]


@pytest.mark.parametrize("hard", HARD)
@pytest.mark.parametrize("period", [1e-3, 5e-4, 1.2e-3, 1.03e-3])
def test_the_period_is_that_of_the_publisher(period, hard):
    time, sequence = readings(period=period, **hard)
    assert true_period(time, sequence) == pytest.approx(period, rel=5e-3)


@pytest.mark.parametrize("numbered", [True, False])
def test_readings_that_share_their_stamps_have_no_period(numbered):
    """Of a clock that stood still: the period was 0, or the analysis ended in a traceback."""
    time = np.maximum(0, np.arange(2400) - 1500) * 1_000_000
    sequence = np.arange(2400) if numbered else np.zeros(2400, dtype=np.int64)
    assert np.isnan(true_period(time, sequence))


def test_losses_are_unknown_where_the_numbers_count_something_else():
    """A publisher that feeds two topics in turn, and numbers behind a chunk that was repaired."""
    time = np.arange(5000) * 2_000_000
    assert timing(time, 2 * np.arange(5000)).lost is None
    assert timing(time, np.arange(5000) + np.where(np.arange(5000) > 2500, 1_673_335, 0)).lost is None
    kept = np.delete(np.arange(5000), slice(100, 2000, 2))
    assert timing(time[kept], kept + 7).lost == 950
