# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What is reported, and for how long."""

from valve_control.control.supervision import conditions


def test_the_first_text_stays_until_it_is_cleared():
    one = conditions.report(conditions.NOTHING, "saturation", "saturated")
    assert conditions.report(one, "saturation", "still saturated") is one
    assert conditions.step(one, 1e6) is one
    assert conditions.clear(one, "saturation") == conditions.NOTHING
    assert conditions.clear(one, "oscillation") is one


def test_an_event_is_over_a_second_after_it_came_last():
    s = conditions.report(conditions.NOTHING, "a", "stays")
    s = conditions.latch(s, "b", "passes", 2.0)
    s = conditions.latch(s, "b", "passes again", 2.5)
    assert conditions.step(s, 3.5).texts == {"a": "stays", "b": "passes"}
    over = conditions.step(s, 3.501)
    assert over.texts == {"a": "stays"} and over.expiry == {}
    assert s.texts == {"a": "stays", "b": "passes"}  # never changed in place
