# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""History of signals: nothing extreme is lost, whatever part of it is drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.analysis.indices import indices
from valve_control.dashboard.history import LONGEST, ROOM, History, recent_indices

START = 1.8e9  # s, a time of today


def filled(count, period=0.001, values=None, parts=7):
    history = History()
    time = START + period * np.arange(count)
    values = np.sin(time - START) if values is None else values
    for t, v in zip(np.array_split(time, parts), np.array_split(values, parts), strict=True):
        history.append(t, v)
    return history, time, values


@given(
    count=st.integers(1, 60_000),
    columns=st.integers(10, 900),
    part=st.tuples(st.floats(0.0, 1.0), st.floats(0.001, 1.0)),
    seed=st.integers(0, 100),
)
def test_the_course_has_the_extremes_of_what_it_shows(count, columns, part, seed):
    values = np.random.default_rng(seed).standard_normal(count)
    history, time, _ = filled(count, values=values)
    span = part[1] * (time[-1] - time[0] + 0.01)
    start = time[0] + part[0] * (time[-1] - time[0])
    course = history.course(start, start + span, columns)
    assert len(course.time) <= 2 * columns + 2
    assert np.all(course.low <= course.high) and np.all(np.diff(course.time) >= 0.0)
    margin = 2.0 * span / columns + 0.001  # whole columns may reach over the ends
    inside = values[(time > start + margin) & (time < start + span - margin)]
    around = values[(time >= start - margin) & (time <= start + span + margin)]
    if len(inside):
        assert course.low.min() <= inside.min() and course.high.max() >= inside.max()
    if len(course.low):
        assert course.low.min() >= around.min() and course.high.max() <= around.max()


def test_the_longest_plot_is_there_at_1_khz_and_what_is_older_is_forgotten():
    history = History()
    for k in range(600):
        time = START + 0.001 * np.arange(k * 1000, (k + 1) * 1000)
        history.append(time, time - START)
        assert len(history) <= ROOM
    end = START + 0.001 * 599_999
    time, values = history.between(end - LONGEST, end)
    assert len(time) == pytest.approx(120_000, abs=1)
    assert values[0] == pytest.approx(end - LONGEST - START, abs=0.0011)
    history.append(end + 0.001 * np.arange(1, ROOM), np.zeros(ROOM - 1))  # more at once than there is room
    assert len(history) <= ROOM and history.newest == pytest.approx(end + 0.001 * (ROOM - 1))


def test_indices_over_the_last_seconds_are_those_of_the_analysis():
    error, time, e = filled(9000, values=np.random.default_rng(1).standard_normal(9000))
    voltage, _, u = filled(9000, values=np.random.default_rng(2).standard_normal(9000))
    found = recent_indices(error, voltage, 5.0, 0.001, time[-1] + 0.9)
    expected = indices(e[-5001:], u[-5001:], 0.001)
    assert found == pytest.approx(expected)
    late, _, _ = filled(9000)
    late.append(time[-1:] + 10.0, np.zeros(1))
    assert recent_indices(late, voltage, 5.0, 0.001, time[-1]) is None  # they do not belong together
    assert recent_indices(History(), voltage, 5.0, 0.001, time[-1]) is None
    assert recent_indices(error, voltage, 5.0, 0.001, time[-1] + 1.1) is None  # the loop has fallen silent
