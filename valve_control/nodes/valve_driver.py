# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `valve_driver`: the LVDT of a real valve, and its amplifier, as topics.

With --check it opens the device, reads for 2 s, tells noise, rate and losses, and writes nothing.
"""

import math
import sys
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Float64

from valve_control.control.drivers import trial
from valve_control.control.drivers.driver import Condition, DriverError
from valve_control.control.parameters import drivers
from valve_control.control.parameters.drivers import LIVE, VALVE_DRIVER
from valve_control.nodes import realtime
from valve_control.nodes.adapter import (
    NEWEST,
    SAMPLES,
    Diagnostics,
    NumberSubscription,
    ParameterSet,
    encoded,
)
from valve_control.nodes.device_node import LEVELS, MOST_MISSING, DeviceNode
from valve_control.nodes.loop import first_line, run, stray_words
from valve_control.nodes.timing import WINDOW, of_periods
from valve_control.parameter import ParameterError, Values, number, word

CHECK = "--check"
NEVER = math.inf
SILENT = 3  # waits without a reading that make a condition


class ValveDriver(DeviceNode):
    """Publishes `spool_position`, takes `valve_voltage`.

    One thread has the device: it waits for a reading, publishes it, waits for the voltage that answers it for
    most of the sample period, gives it, and waits for the next reading.
    """

    live = LIVE

    def __init__(self, **options: Any) -> None:
        super().__init__("valve_driver", **options)
        self._next = NEVER
        self._begun = False
        self._voltage = 0.0
        self._voltage_at = -NEVER  # s, when the last one came
        self._fed = False  # whether a voltage holds the output
        self._position = math.nan
        self._quiet = 0  # waits in a row without a reading
        self._refused = 0.0  # the last voltage that was not finite
        self._refused_until = -NEVER
        self._arrivals: deque[float] = deque(maxlen=WINDOW)
        self._counts = dict.fromkeys(("late_voltages", "voltage_refused", "voltage_timeouts"), 0)
        self._diagnostics = Diagnostics(self, self._diagnose)
        ParameterSet(self, VALVE_DRIVER, self._build, self._apply)
        if self.device_values["autostart"]:
            self.autostart()
        else:
            self.get_logger().info("unconfigured, waits for lifecycle transitions")

    def _build(self, values: Values) -> None:
        self.refuse_changes(values)
        drivers.device(values)

    def _apply(self, values: Values, built: None) -> None:
        self.use(values)
        self._watchdog = number(values, "watchdog")
        self._wait = number(values, "answer_share") * number(values, "sample_period")

    # Life

    def open(self) -> None:
        """Create publisher and subscription."""
        self._voltages = NumberSubscription(self, "valve_voltage", NEWEST)
        self._positions = self.create_publisher(Float64, "spool_position", SAMPLES)

    def begin(self) -> None:
        """Drop voltages that wait; the output is switched on at 0 V when the loop runs."""
        for _ in self._voltages.take():
            pass
        self._quiet = 0
        self._told = ()
        self._arrivals.clear()
        self._begun = False
        self._next = 0.0
        self.get_logger().info(
            f"{word(self.device_values, 'driver')}: waiting for readings and valve_voltage"
        )

    def end(self) -> None:
        """Switch the output off."""
        self._switch(False)

    def _switch(self, on: bool) -> None:
        self.device.enable(on)
        self._voltage, self._fed, self._voltage_at = 0.0, False, -NEVER

    # Work

    def inputs(self) -> Sequence[NumberSubscription]:
        """Subscription of the voltage, while one is waited for."""
        return (self._voltages,) if self.working else ()

    def due(self) -> float:
        """Time [s] from which the next reading is waited for without a voltage."""
        return self._next if self.working else NEVER

    def work(self) -> bool:
        """Give the voltage, wait for the next reading and publish it."""
        if not self.working:
            return False
        if not self._begun:
            self._begun = True
            self._switch(True)
        if not self._take_voltage():
            self._repeat()
        reading = self.device.read()
        if reading is None:
            self._quiet += 1
            self._next = 0.0
            return True
        self._quiet = 0
        # One that comes as late as this is no answer to the reading that is published now.
        self._counts["late_voltages"] += self._take_voltage()
        for _ in range(min(reading.lost, MOST_MISSING)):
            self._positions.publish(encoded(math.nan))
        self._positions.publish(encoded(reading.signal))
        self._position = reading.signal
        now = time.monotonic()
        self._arrivals.append(now)
        self._next = now + self._wait
        return True

    def _take_voltage(self) -> bool:
        """Give the newest voltage that has come; returns whether one has."""
        waiting = [voltage for voltage, _ in self._voltages.take()]
        if not waiting:
            return False
        taken = waiting[-1]
        if not math.isfinite(taken):
            self._counts["voltage_refused"] += 1
            self._refused, self._refused_until = taken, time.monotonic() + 1.0
            taken = 0.0
        self._voltage, self._fed, self._voltage_at = taken, True, time.monotonic()
        self.device.write(taken)
        return True

    def _repeat(self) -> None:
        """Give the last voltage again, which the card's own watchdog waits for; 0 V after this one's time."""
        if self._fed and time.monotonic() - self._voltage_at > self._watchdog:
            self._fed = False
            self._voltage = 0.0
            self._counts["voltage_timeouts"] += 1
        self.device.write(self._voltage)

    def report(self) -> None:
        """Log and publish the conditions if they have changed."""
        if self.working:
            conditions = self._conditions()
            if self.differ(conditions):
                self.tell(conditions)
                if not conditions:
                    self.get_logger().info("ok")
                self._diagnose()

    def _conditions(self) -> tuple[Condition, ...]:
        """What is wrong now, worst first."""
        found = self.device.conditions()
        own: list[Condition] = []
        if self._voltage_at > -NEVER and not self._fed:
            text = f"no valve_voltage for {self._watchdog:g} s: the output is at 0 V"
            own.append(Condition("no_voltage", "safe", text))
        if time.monotonic() < self._refused_until:
            text = f"valve_voltage is {self._refused}: 0 V is given instead"
            own.append(Condition("voltage_not_finite", "degraded", text))
        if self._quiet >= SILENT and "device_gone" not in {c.name for c in found}:
            own.append(Condition("no_reading", "safe", "the device gives no readings"))
        return tuple(sorted((*found, *own), key=lambda c: c.level, reverse=True))

    # Diagnostics

    def _diagnose(self) -> None:
        level, text = DiagnosticStatus.OK, "driving"
        conditions: tuple[Condition, ...] = ()
        if self.working and (conditions := self._conditions()):
            level, text = LEVELS[conditions[0].level], "; ".join(c.text for c in conditions)
        elif not self._fed:
            text = "waiting for valve_voltage, the output is at 0 V"
        period = number(self.device_values, "sample_period")
        self._diagnostics.tell(
            level,
            text,
            self._figures(conditions),
            lambda: of_periods(self._arrivals, period),
            realtime.obtained,
        )

    def _figures(self, conditions: tuple[Condition, ...]) -> dict[str, Any]:
        device = self._device
        return {
            "driver": word(self.device_values, "driver"),
            "conditions": ", ".join(condition.name for condition in conditions),
            "readings": 0 if device is None else device.readings,
            "lost": 0 if device is None else device.lost,
            "reopened": 0 if device is None else device.reopened,
            **self._counts,
            "position_V": f"{self._position:.4f}",
            "voltage_V": f"{self._voltage:.4f}",
        }


def check(arguments: Sequence[str]) -> int:
    """Dry run with the parameters of a command line; returns the exit status."""
    try:
        if stray := stray_words(arguments):
            raise ParameterError(
                f"{' '.join(stray)} stands before --ros-args; write --ros-args -p NAME:=VALUE"
            )
        rclpy.init(args=["valve_driver", *arguments])
    except Exception as error:  # rclpy has no public type for bad --ros-args
        print(f"valve_driver: {first_line(error)}", file=sys.stderr)
        return 2
    try:
        node = Node("valve_driver", enable_rosout=False, start_parameter_services=False)
        values = ParameterSet(node, VALVE_DRIVER, drivers.sides).values
        device = drivers.device(values)
        tried = trial.run(device)
    except (ParameterError, DriverError) as error:
        print(f"valve_driver: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    print("\n".join(trial.told(tried, device, number(values, "sample_period"))))
    return 0 if tried.volts else 1


def main() -> int:
    """Entry point of `ros2 run valve_control valve_driver`."""
    words = sys.argv[1:]
    if CHECK in words and not {"-h", "--help"} & set(words):
        return check([word for word in words if word != CHECK])
    return run(lambda: [ValveDriver()])


if __name__ == "__main__":
    sys.exit(main())
