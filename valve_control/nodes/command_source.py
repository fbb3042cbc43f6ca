"""Node `command_source`: stands in for the upper-level hydraulic controller."""

import sys
import time
from typing import Any

from rclpy.node import Node
from std_msgs.msg import Float64

from valve_control.nodes.adapter import LATEST, ParameterSet, run
from valve_control.parameters import build
from valve_control.parameters.table import COMMAND, Values
from valve_control.simulation import offline


class CommandSource(Node):
    """Publishes `spool_command` once per sample period, from the moment enough others listen.

    A change of parameters starts the new shape from its beginning; at the end the last value is held.
    """

    def __init__(self) -> None:
        super().__init__("command_source")
        self._timer: Any = None
        self._period: float | None = None
        self._message = Float64()
        self._publisher = self.create_publisher(Float64, "spool_command", LATEST)
        self._parameters = ParameterSet(self, COMMAND, offline.commands, self._apply)

    def _apply(self, values: Values, commands: Any) -> None:
        self._commands = commands.tolist()
        self._listeners = int(build.number(values, "listeners"))
        self._began: float | None = None
        self._done = False
        period = build.number(values, "sample_period")
        if period != self._period:
            self._period = period
            if self._timer is not None:
                self.destroy_timer(self._timer)
            self._timer = self.create_timer(period, self._tick)
        self.get_logger().info(
            f"{values['scenario']}: {len(self._commands) * period:g} s of commands, waiting for {self._listeners} listener(s)"
        )

    def _tick(self) -> None:
        if self._began is None:
            if self._publisher.get_subscription_count() < self._listeners:
                return
            self._began = time.monotonic()
            self.get_logger().info("begins")
        assert self._period is not None
        index = int((time.monotonic() - self._began) / self._period)
        if index >= len(self._commands):
            index = len(self._commands) - 1
            if not self._done:
                self._done = True
                self.get_logger().info("done, holds the last command")
        self._message.data = self._commands[index]
        self._publisher.publish(self._message)


def main() -> int:
    """Entry point of `ros2 run valve_control command_source`."""
    return run(CommandSource)


if __name__ == "__main__":
    sys.exit(main())
