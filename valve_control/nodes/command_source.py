# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `command_source`: stands in for the upper-level hydraulic controller, and for its faults."""

import functools
import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.parameter import Parameter
from scipy.interpolate import Akima1DInterpolator
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectoryPoint

from valve_control.control.commands import scenarios
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND
from valve_control.nodes.adapter import (
    SAMPLES,
    NumberSubscription,
    ParameterSet,
    encoded,
    encoded_point,
    number_of,
)
from valve_control.nodes.loop import Worker, run
from valve_control.parameter import ParameterError, Values, number, word

BEYOND = 1000.0  # V, a command out of range
MOST_LOST = 1000  # messages of the trigger in a row
SHAPING = [p.name for p in COMMAND if not p.name.startswith("fault.")]


class CommandSource(Worker):
    """Publishes `spool_command` (or `spool_trajectory`), from the moment on at which enough others listen.

    Once per sample period, LVDT reading or voltage. A change of its shape starts it
    from its beginning; at the end the last value is held. In lockstep the first command is for the first
    reading, and each reading calls for the command of the next.
    """

    def __init__(self) -> None:
        super().__init__("command_source")
        self._shaped_by: list[Any] = []
        self._motion: Callable[[float], Any] = float  # V  at the time [s] at which a late timer sends it
        self._commands = self._rates = self._accels = np.empty(0)
        self._fault, self._fault_left = "none", 0
        self._next = 0.0
        self._epoch = 0.0  # s  of the first command of this motion
        self._last_time = 0.0  # s  of the last command
        self._sent = 0
        self._arrived = 0  # messages of the trigger, lost ones too
        self._number = 0  # of the last one, 0 where they have none
        self._ahead = False  # lockstep: whether the command of the next reading is sent
        values = ParameterSet(self, COMMAND, self._build, self._apply, fixed=("trigger", "message")).values
        self._trigger, self._message = word(values, "trigger"), word(values, "message")
        if self._message == "trajectory":
            self._publisher = self.create_publisher(JointTrajectoryPoint, "spool_trajectory", SAMPLES)
        else:
            self._publisher = self.create_publisher(Float64, "spool_command", SAMPLES)
        topic = {"timer": "", "lockstep": "spool_position"}.get(self._trigger, self._trigger)
        # What each command follows.
        self._pacing = NumberSubscription(self, topic, SAMPLES) if topic else None

    def _build(self, values: Values) -> Any:
        """Commands [V] of the shape; an hour of them takes a second, so only a new shape is computed."""
        if values["trigger"] == "lockstep" and values["fault.command"] == "silent":
            raise ParameterError(
                "fault.command is silent, but in lockstep each reading waits for its command"
            )
        same = [values[name] for name in SHAPING] == self._shaped_by
        return self._commands if same else build.commands(values)

    def _apply(self, values: Values, commands: Any) -> None:
        fault = word(values, "fault.command")
        if fault != self._fault:
            self._fault = fault
            self._fault_left = int(number(values, "fault.samples")) if fault != "none" else 0
        shaped_by = [values[name] for name in SHAPING]
        if shaped_by == self._shaped_by:
            return
        self._shaped_by = shaped_by
        if values["scenario"] == "array":
            held = np.append(commands, commands[-1])
            times = np.arange(len(held)) * number(values, "sample_period")
            self._motion = Akima1DInterpolator(times, held)  # overshoots no step
        else:
            self._motion = functools.partial(scenarios.command, build.shape(values))
        self._commands = commands
        self._rates, self._accels = build.derivatives(commands, number(values, "sample_period"))
        self._turn = -1
        self._listeners = int(number(values, "listeners"))
        self._period = number(values, "sample_period")
        self._delay = number(values, "delay")
        self._met: float | None = None
        self._began: float | None = None
        self._done = False
        self._next = time.monotonic()
        self.get_logger().info(
            f"{values['scenario']}: {len(self._commands) * self._period:g} s of commands, "
            f"waiting for {self._listeners} listener(s)"
        )

    def inputs(self) -> Sequence[NumberSubscription]:
        """Subscription of the readings or voltages, if they pace the commands."""
        return () if self._pacing is None else (self._pacing,)

    def due(self) -> float:
        """Time [s] of the timer's next command, or of the next look for listeners."""
        if self._trigger == "timer" or (self._trigger == "lockstep" and self._began is None):
            return self._next
        return math.inf

    def work(self) -> bool:
        """Send the commands that are due."""
        if self._trigger == "timer":
            now = time.monotonic()
            if now < self._next:
                return False
            self._next = max(self._next + self._period, now)
            self._send(now / self._period)
            return True
        assert self._pacing is not None
        worked = False
        if self._trigger == "lockstep" and self._began is None:
            if self._publisher.get_subscription_count() < self._listeners:
                self._next = time.monotonic() + 10.0 * self._period
                return False
            self._begin(0.0)
            if not self._ahead:
                self._ahead = True
                self._publish(0)
            worked = True
        for _, info in self._pacing.take():
            if self._trigger == "lockstep":
                self._publish(self._sent)
            else:
                before, self._number = self._number, number_of(info)
                ahead = self._number - before if before else 1
                # Numbers that fall or jump far are those of another publisher, or of one that began anew.
                self._arrived += ahead if 0 < ahead < MOST_LOST else 1
                self._send(float(self._arrived))
            worked = True
        return worked

    def _send(self, now: float) -> None:
        """Publish the command that is due at ``now`` [sample periods]."""
        if self._began is None:
            if self._publisher.get_subscription_count() < self._listeners:
                return
            if self._met is None:
                self._met = now
            if (now - self._met) * self._period < self._delay:
                return
            self._begin(now)
        assert self._began is not None
        past = max(0.0, now - self._began)
        self._publish(int(past), past * self._period)

    def _begin(self, now: float) -> None:
        self._began = now
        self._sent = 0
        self._turn = -1
        # The time of the points goes on where a motion begins anew.
        self._epoch = max(time.monotonic(), self._last_time + self._period)
        self.get_logger().info("begins")

    def _publish(self, index: int, time: float = math.nan) -> None:
        """Send the command of the sample ``index``, or of the ``time`` [s] at which a timer sends it."""
        trajectory = self._message == "trajectory"
        if trajectory and index == self._turn:
            return
        self._last_time = self._epoch + index * self._period
        self._turn = index
        rate = accel = 0.0
        if index < len(self._commands):
            rate, accel = self._rates[index], self._accels[index]
        if index >= len(self._commands):
            index = len(self._commands) - 1
            if not self._done:
                self._done = True
                self.get_logger().info("done, holds the last command")
        command = float(self._commands[index])
        if self._trigger == "timer" and not trajectory:  # a time stamp tells when it is sent
            command = float(self._motion(min(max(time, 0.0), (len(self._commands) - 1) * self._period)))
        if self._fault == "not_finite":
            command = math.nan
        elif self._fault == "out_of_range":
            command, rate, accel = BEYOND, 0.0, 0.0
        self._sent += 1
        if self._fault != "silent":
            # In lockstep points belong to readings, not to times.
            stamp = 0 if self._trigger == "lockstep" else round(self._last_time * 1e9)
            self._publisher.publish(
                encoded_point(command, rate, accel, stamp) if trajectory else encoded(command)
            )
        if self._fault_left > 0:
            self._fault_left -= 1
            if self._fault_left == 0:
                self.set_parameters([Parameter("fault.command", value="none")])


def main() -> int:
    """Entry point of `ros2 run valve_control command_source`."""
    return run(lambda: [CommandSource()])


if __name__ == "__main__":
    sys.exit(main())
