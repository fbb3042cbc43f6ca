# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of the upper level: the reference is the trajectory itself, within (6) and (7)."""

import math

import numpy as np
import pytest
from slow import PERIOD, SETTLED, bare, made, motion_of, moving, run, sine

from valve_control.control.commands import scenarios
from valve_control.control.supervision import command_course, trajectory
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.control_step import BOTH
from valve_control.control.supervision.memory import Mode

STROKE = scenarios.Shape("point_to_point", 1.5, 0.0, 0.1, 1.0, 1.0, 40.0, 2000.0, 0.4, 1.0)


def stroke(time):
    return scenarios.command(STROKE, time)


def sines(time):
    return sine(time) + 0.3 * sine(time, 1.0, 9.0) + 0.1 * sine(time, 1.0, 15.0)


@pytest.mark.parametrize("shape", [sine, sines, stroke])
@pytest.mark.parametrize("law", ["arc", "oarc"])
def test_the_error_is_well_below_that_of_bare_commands_at_the_same_chatter(law, shape):
    without, with_derivatives = (run(send(shape), 1, shape, controller=law) for send in (bare, moving))
    assert with_derivatives.error < 0.6 * without.error
    assert with_derivatives.chatter < 1.05 * without.chatter
    assert with_derivatives.supervisor.mode is Mode.OK


def test_points_that_stop_leave_the_spool_at_rest_and_then_bring_it_to_neutral():
    supervisor = made(controller="open_loop", command_timeout=0.1, command__bridge=0.0)
    for k in range(5):
        supervisor.trajectory(Motion(0.01 * k, 10.0, 0.0))
        supervisor.sample(0.001 * (k % 3), k + 1)
    got = []
    for k in range(5, 1200):
        supervisor.sample(0.001 * (k % 3), k + 1)
        got.append(supervisor.telemetry()[2])
    assert got[0] == pytest.approx(0.05)  # it goes on until the next is late
    assert max(got) < 0.04 + 10.0 * 2.0 * PERIOD and got[50] == 0.04
    assert "command_silent" in supervisor.conditions and got[-1] == pytest.approx(0.0, abs=1e-9)


REFUSED = {
    "no derivatives": (
        lambda s: s.trajectory_refused(1, 0, 0),
        "1 positions, 0 velocities and 0 accelerations",
    ),
    "nan": (lambda s: s.trajectory(Motion(0.1, math.nan, 0.0)), "velocity nan refused"),
    "backwards": (
        lambda s: s.trajectory(Motion(0.1, 0.0, 0.0), 0.98, 0.0),
        "0.02 s before that of the last one",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_point_that_cannot_be_used_is_refused_in_one_sentence_and_the_last_one_holds(what):
    send, text = REFUSED[what]
    supervisor = made(controller="open_loop")
    supervisor.trajectory(Motion(0.05, 0.0, 0.0), 1.0, 0.0)
    supervisor.sample(0.0, 1)
    before = supervisor.memory.trajectory
    send(supervisor)
    supervisor.sample(0.001, 2)
    assert supervisor.memory.trajectory == before and supervisor.memory.command.value == 0.05
    assert text in supervisor.reason and supervisor.reason.count(".") <= 1
    assert supervisor.mode is Mode.DEGRADED and supervisor.memory.counts["command_refused"] == 1
    for k in range(3, 1100):
        supervisor.trajectory(Motion(0.05, 0.0, 0.0), 1.0 + k * PERIOD, 0.0)
        supervisor.sample(0.001 * (k % 3), k)
    assert supervisor.mode is Mode.OK


@pytest.mark.parametrize("every", [1, 5, 10])
def test_a_clock_that_is_set_back_does_not_stop_the_motion(every):
    """Two points are refused at most; meanwhile the motion goes on, and differs by its way then at most."""

    def send(supervisor, time, since):
        supervisor.trajectory(
            Motion(*motion_of(time)), 5000.0 + time - (3600.0 if time >= 0.8 else 0.0), since
        )

    made_run = run(send, every, controller="open_loop")
    off = np.abs(made_run.command - made_run.wanted)[SETTLED:]
    assert np.max(off) < 0.001 + 2 * every * PERIOD * 2.0 * math.pi * 3.0
    assert 1 <= made_run.supervisor.memory.counts["command_refused"] <= 2


def test_both_at_once_the_trajectory_commands_and_it_is_said():
    supervisor = made(controller="open_loop", command_timeout=0.05)
    supervisor.command(0.02)
    supervisor.sample(0.0, 1)
    assert supervisor.memory.command.value == 0.02
    for k in range(2, 40):
        supervisor.trajectory(Motion(0.05, 0.0, 0.0))
        supervisor.command(0.02)
        supervisor.sample(0.001 * (k % 3), k)
        assert supervisor.memory.command.value == 0.05
        assert BOTH in supervisor.reason and supervisor.mode is Mode.DEGRADED
    for k in range(40, 200):  # the trajectory ends: commands count once it is silent
        supervisor.command(0.02)
        supervisor.sample(0.001 * (k % 3), k)
        assert (supervisor.memory.command.value == 0.02) == (k > 89)
    assert "command_silent" not in supervisor.conditions


@pytest.mark.parametrize("gone", ["trajectory_gone", "command_gone"])
def test_when_who_sent_the_trajectory_leaves_commands_count_at_once(gone):
    supervisor = made(controller="open_loop")
    supervisor.trajectory(Motion(0.05, 0.0, 0.0))
    supervisor.sample(0.0, 1)
    getattr(supervisor, gone)()
    supervisor.sample(0.001, 2)
    supervisor.command(0.02)
    supervisor.sample(0.0, 3)
    assert supervisor.memory.command.value == 0.02 and supervisor.memory.trajectory is None


def test_positions_beyond_the_limit_are_limited_and_stand_there():
    supervisor = made(controller="open_loop", command_limit=2.0)
    supervisor.trajectory(Motion(2.5, 40.0, 0.0))
    assert supervisor.memory.counts["command_limited"] == 1
    limited = command_course.Params(0.006, 0.0, 2.0, PERIOD)
    assert trajectory.motion(limited, supervisor.memory.trajectory, 0.002) == Motion(2.0, 0.0, 0.0)
