import numpy as np
import pytest

from valve_control.analysis.timing import lost_messages, timing


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


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_messages_have_no_rate(count):
    t = timing(np.arange(count), np.zeros(count, dtype=np.int64))
    assert t.messages == count and np.isnan(t.rate_hz) and t.gaps == 0
