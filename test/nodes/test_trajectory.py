# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""`spool_trajectory` over DDS: the controller, the command source, the recorder."""

import math

import numpy as np
import pytest
from bench import spin_until
from trajectory_msgs.msg import JointTrajectoryPoint

from research.campaigns.processes import process
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND
from valve_control.parameter import defaults, updated


def test_a_slow_command_source_sends_trajectories(ros, tmp_path):
    got = []
    ros.create_subscription(JointTrajectoryPoint, "spool_trajectory", got.append, 100)
    words = (
        "message:=trajectory",
        "sample_period:=0.01",
        "scenario:=sine",
        "frequency:=1.0",
        "delay:=0.1",
        "start:=0.0",
    )
    settings = [word for w in words for word in ("-p", w)]
    with process("command_source", settings, tmp_path / "s.log"):
        spin_until(ros, lambda: len(got) >= 60, "60 points")
    sine = {"scenario": "sine", "frequency": 1.0, "start": 0.0}
    commands = build.commands(updated(COMMAND, defaults(COMMAND), {**sine, "sample_period": 0.01}))
    rates, accels = build.derivatives(commands, 0.01)
    sent = set(zip(commands.tolist(), rates.tolist(), accels.tolist(), strict=True))
    assert all((m.positions[0], m.velocities[0], m.accelerations[0]) in sent for m in got)
    times = [m.time_from_start.sec + 1e-9 * m.time_from_start.nanosec for m in got]
    steps = np.diff(times) / 0.01
    assert np.all(steps > 0.5) and np.median(steps) == pytest.approx(1.0, abs=1e-3)
    rates, accels = build.derivatives(build.commands(updated(COMMAND, defaults(COMMAND), sine)), 0.001)
    w = 2.0 * math.pi
    k = np.arange(1, 999)
    assert np.allclose(rates[k], w * 2.92 * np.cos(w * k * 1e-3), atol=1e-3)
    assert np.allclose(accels[k], -w * w * 2.92 * np.sin(w * k * 1e-3), atol=1e-2)
