"""Node `command_source`: stands in for the upper-level hydraulic controller, and for its faults."""

import math
import sys
import time
from collections.abc import Sequence
from typing import Any

from rclpy.parameter import Parameter
from std_msgs.msg import Float64

from valve_control.nodes.adapter import SAMPLES, NumberSubscription, ParameterSet, encoded
from valve_control.nodes.loop import Worker, run
from valve_control.parameters import build
from valve_control.parameters.table import COMMAND, Values
from valve_control.simulation import offline

BEYOND = 1000.0  # V, a command out of range
SHAPING = [p.name for p in COMMAND if not p.name.startswith("fault.")]


class CommandSource(Worker):
    """Publishes `spool_command` once per sample period or LVDT reading, from the moment enough others listen.

    A change of its shape starts it from its beginning; at the end the last value is held.
    """

    def __init__(self) -> None:
        super().__init__("command_source")
        self._readings: NumberSubscription | None = None
        self._shaped_by: list[Any] = []
        self._commands: list[float] = []
        self._fault = "none"
        self._fault_left = 0
        self._second: Any = None
        self._next = 0.0
        self._sent = 0
        self._publisher = self.create_publisher(Float64, "spool_command", SAMPLES)
        ParameterSet(self, COMMAND, self._build, self._apply)

    def _build(self, values: Values) -> Any:
        """Commands of the shape; an hour of them takes a second, so only a new shape is built."""
        same = [values[name] for name in SHAPING] == self._shaped_by
        return self._commands if same else offline.commands(values).tolist()

    def _apply(self, values: Values, commands: Any) -> None:
        fault = build.word(values, "fault.command")
        if fault != self._fault:
            self._fault = fault
            self._fault_left = int(build.number(values, "fault.samples")) if fault != "none" else 0
            if fault == "second_publisher" and self._second is None:
                self._second = self.create_publisher(Float64, "spool_command", SAMPLES)
            elif fault != "second_publisher" and self._second is not None:
                self.destroy_publisher(self._second)
                self._second = None
        shaped_by = [values[name] for name in SHAPING]
        if shaped_by == self._shaped_by:
            return
        self._shaped_by = shaped_by
        self._commands = commands
        self._listeners = int(build.number(values, "listeners"))
        self._period = build.number(values, "sample_period")
        self._delay = build.number(values, "delay")
        self._met: float | None = None
        self._began: float | None = None
        self._done = False
        self._trigger = build.word(values, "trigger")
        if self._trigger != "timer" and self._readings is None:
            self._readings = NumberSubscription(self, "spool_position", SAMPLES)
        elif self._trigger == "timer" and self._readings is not None:
            self._readings.destroy()
            self._readings = None
        self._next = time.monotonic()
        self.get_logger().info(
            f"{values['scenario']}: {len(self._commands) * self._period:g} s of commands, "
            f"waiting for {self._listeners} listener(s)"
        )

    def inputs(self) -> Sequence[NumberSubscription]:
        """The readings that pace the commands, if they do."""
        return () if self._readings is None else (self._readings,)

    def due(self) -> float:
        """When the timer's next command is due, or the next look at the listeners."""
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
        assert self._readings is not None
        worked = False
        if self._trigger == "lockstep" and self._began is None:
            if self._publisher.get_subscription_count() < self._listeners:
                self._next = time.monotonic() + 10.0 * self._period
                return False
            self._begin(0.0)
            self._publish(0)
            worked = True
        for _, info in self._readings.take():
            if self._trigger == "lockstep":
                self._publish(self._sent)
            else:
                self._send(float(info["publication_sequence_number"]))
            worked = True
        return worked

    def _send(self, now: float) -> None:
        """Publish the command that is due at ``now``, in periods."""
        if self._began is None:
            if self._publisher.get_subscription_count() < self._listeners:
                return
            if self._met is None:
                self._met = now
            if (now - self._met) * self._period < self._delay:
                return
            self._begin(now)
        assert self._began is not None
        self._publish(max(0, int(now - self._began)))

    def _begin(self, now: float) -> None:
        self._began = now
        self._sent = 0
        self.get_logger().info("begins")

    def _publish(self, index: int) -> None:
        if index >= len(self._commands):
            index = len(self._commands) - 1
            if not self._done:
                self._done = True
                self.get_logger().info("done, holds the last command")
        command = float(self._commands[index])
        if self._fault == "not_finite":
            command = math.nan
        elif self._fault == "out_of_range":
            command = BEYOND
        self._sent += 1
        if self._fault != "silent":
            self._publisher.publish(encoded(command))
        if self._fault_left > 0:
            self._fault_left -= 1
            if self._fault_left == 0:
                self.set_parameters([Parameter("fault.command", value="none")])


def main() -> int:
    """Entry point of `ros2 run valve_control command_source`."""
    return run(lambda: [CommandSource()])


if __name__ == "__main__":
    sys.exit(main())
