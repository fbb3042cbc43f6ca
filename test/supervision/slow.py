# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A supervisor on the simulated valve of the examples, under an upper level that is slower than the loop."""

import math
from typing import NamedTuple

import changed
import numpy as np

from valve_control.control.analysis.indices import rms
from valve_control.control.parameters import build, files, ros_file
from valve_control.control.plant import valve
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.supervisor import Supervisor

PERIOD = 0.001
SETTLED = 400  # samples
D3FXE = files.load(str(ros_file.config_folder() / "d3fxe.yaml"))["valve_simulator"]


class Made(NamedTuple):
    """A run, one entry a sample."""

    command: np.ndarray  # V  as the law got it
    voltage: np.ndarray  # V
    position: np.ndarray  # V
    wanted: np.ndarray  # V
    supervisor: Supervisor

    @property
    def chatter(self):
        """c_u after the beginning."""
        moving = self.voltage[SETTLED:]
        return rms(np.diff(moving)) / rms(moving)

    @property
    def error(self):
        """True rms error [V] after the beginning."""
        return rms((self.position - self.wanted)[SETTLED:])


def sine(time, amplitude=1.0, frequency=3.0):
    """Fades in, so that the motion begins within the limits."""
    ease = min(1.0, time / 0.3)
    return amplitude * ease * ease * (3.0 - 2.0 * ease) * math.sin(2.0 * math.pi * frequency * time)


SWIFT = {"lvdt__max_rate": 1000.0}


def made(**changes):
    return changed.supervisor(**SWIFT, **changes)


def run(send, every, shape=sine, **changes):
    """2 s; every ``every`` samples ``send`` (supervisor, time, seconds after the last reading) is called."""
    supervisor = made(**changes)
    p = build.valve_params(changed.valve(**D3FXE))
    s = valve.initial(p)
    random = np.random.default_rng(5)
    got = []
    for k in range(2000):
        now = k * PERIOD
        if k % every == 0:
            send(supervisor, now, PERIOD)
        reading = valve.read(p, s, float(random.standard_normal()))
        voltage = supervisor.sample(reading, k + 1)
        got.append((supervisor.telemetry()[2], voltage, s.x.x0, shape(now)))
        s = valve.step(p, s, voltage)
    return Made(*np.array(got).T, supervisor)


def bare(shape=sine):
    """An upper level that sends numbers."""
    return lambda supervisor, time, since: supervisor.command(shape(time), 1.0 + time, since)


def moving(shape=sine):
    """An upper level that sends trajectories."""

    def send(supervisor, time, since):
        assert supervisor.trajectory(motion_of(time, shape), 1.0 + time, since)

    return send


def motion_of(time, shape=sine):
    """Point of a trajectory along ``shape``: the derivatives by differences of 0.1 ms."""
    h = 1e-4
    before, here, after = (shape(max(0.0, t)) for t in (time - h, time, time + h))
    return Motion(here, (after - before) / (2.0 * h), (after - 2.0 * here + before) / (h * h))
