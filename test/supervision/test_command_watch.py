# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The upper level: refused, limited and silent commands, the way back to neutral and from there."""

import math

import pytest

from valve_control.control.supervision import command_watch
from valve_control.control.supervision.bumpless_transfer import ZERO, Offset

PERIOD = 0.001
P = command_watch.Params(timeout=0.1, limit=3.0, rate=5.0, accel=100.0, period=PERIOD)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused_but_shows_that_somebody_is_there(value):
    s = command_watch.taken(P, command_watch.NOTHING, 1.0, 0.0)._replace(gone_since=0.5)
    after = command_watch.taken(P, s, value, 1.0)
    assert (after.value, after.time, after.gone_since) == (1.0, PERIOD, None)


def test_a_command_is_limited():
    s = command_watch.taken(P, command_watch.NOTHING, -500.0, 0.0)
    assert s.value == -3.0


def test_before_the_first_command_the_spool_stays_where_it_was():
    s = command_watch.welcomed(P, command_watch.NOTHING, 0.7, 0.0)
    assert command_watch.step(P, s, Offset(0.1, 0.0), 5.0)[0] == pytest.approx(0.8, abs=1e-15)


def test_silence_brings_the_spool_to_neutral_and_a_new_command_takes_it_from_there():
    """Within rate and acceleration, and without a step when the upper level comes back."""
    s, offset, way = command_watch.taken(P, command_watch.NOTHING, 2.0, 0.0), ZERO, []
    for k in range(1, 400):
        command, s, offset = command_watch.step(P, s, offset, k * PERIOD)
        way.append(command)
    speed = [(b - a) / PERIOD for a, b in zip(way, way[1:], strict=False)]
    bend = [(b - a) / PERIOD for a, b in zip(speed, speed[1:], strict=False)]
    assert way[99] == 2.0 and way[102] < 2.0 and offset is ZERO and s.homing is not None
    assert max(map(abs, speed)) <= 1.001 * P.rate and max(map(abs, bend)) <= 1.001 * P.accel
    s = command_watch.taken(P, s, -1.0, 399 * PERIOD)
    command, s, offset = command_watch.step(P, s, offset, 400 * PERIOD)
    assert s.homing is None and abs(command - way[-1]) <= 1.001 * P.rate * PERIOD
    assert offset.value == pytest.approx(command + 1.0, abs=1e-12)


def test_without_a_timeout_a_command_holds_for_ever():
    s = command_watch.taken(P, command_watch.NOTHING, 2.0, 0.0)
    patient = P._replace(timeout=0.0)
    assert command_watch.step(patient, s._replace(gone_since=1.0), ZERO, 1e6)[0] == 2.0
