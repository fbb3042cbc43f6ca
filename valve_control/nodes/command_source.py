"""Node `command_source`: stands in for the upper-level hydraulic controller."""

import sys
import time
from typing import Any

from rclpy.node import Node
from std_msgs.msg import Float64

from valve_control.nodes.adapter import LATEST, SAMPLES, ParameterSet, run
from valve_control.parameters import build
from valve_control.parameters.table import COMMAND, Values
from valve_control.simulation import offline


class CommandSource(Node):
    """Publishes `spool_command` once per sample period or LVDT reading, from the moment enough others listen.

    A change of parameters starts the new shape from its beginning; at the end the last value is held.
    """

    def __init__(self) -> None:
        super().__init__("command_source")
        self._timer: Any = None
        self._readings: Any = None
        self._paced_by: tuple[str, float] | None = None
        self._message = Float64()
        self._publisher = self.create_publisher(Float64, "spool_command", LATEST)
        self._tuning = ParameterSet(self, COMMAND, offline.commands, self._apply)

    def _apply(self, values: Values, commands: Any) -> None:
        self._commands = commands.tolist()
        self._listeners = int(build.number(values, "listeners"))
        self._period = build.number(values, "sample_period")
        self._delay = build.number(values, "delay")
        self._met: float | None = None
        self._began: float | None = None
        self._done = False
        trigger = build.word(values, "trigger")
        if (trigger, self._period) != self._paced_by:
            self._paced_by = (trigger, self._period)
            self._pace(trigger)
        self.get_logger().info(
            f"{values['scenario']}: {len(self._commands) * self._period:g} s of commands, "
            f"waiting for {self._listeners} listener(s)"
        )

    def _pace(self, trigger: str) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        if self._readings is not None:
            self.destroy_subscription(self._readings)
            self._readings = None
        if trigger == "timer":
            self._timer = self.create_timer(self._period, self._tick)
        else:
            self._readings = self.create_subscription(Float64, "spool_position", self._on_reading, SAMPLES)

    def _tick(self) -> None:
        self._send(time.monotonic() / self._period)

    def _on_reading(self, message: Float64, info: dict[str, Any]) -> None:
        self._send(float(info["publication_sequence_number"]))

    def _send(self, now: float) -> None:
        """Publish the command that is due at ``now``, in periods."""
        if self._began is None:
            if self._publisher.get_subscription_count() < self._listeners:
                return
            if self._met is None:
                self._met = now
            if (now - self._met) * self._period < self._delay:
                return
            self._began = now
            self.get_logger().info("begins")
        index = max(0, int(now - self._began))
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
