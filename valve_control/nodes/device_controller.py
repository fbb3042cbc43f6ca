# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A controller that has the device itself: reading, law and voltage in one thread, the topics afterwards."""

import math
import time
from collections.abc import Iterator, Sequence
from typing import Any

from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from valve_control.control.drivers.device import Device
from valve_control.control.parameters import drivers
from valve_control.control.parameters.controller import CONTROLLER
from valve_control.control.parameters.drivers import DEVICE, LIVE
from valve_control.nodes.adapter import SAMPLES, PolledSubscription, encoded
from valve_control.nodes.controller_node import Controller
from valve_control.nodes.device_node import LEVELS, MOST_MISSING, DeviceNode
from valve_control.nodes.rclpy_internals import sender
from valve_control.parameter import ParameterError, Values, word

OWN = {parameter.name for parameter in CONTROLLER}
SERVING = 0.65  # of a period after a reading, in which the process serves others


class DeviceReadings:
    """Readings of a device in the form of a subscription's."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._number = 0
        self.fresh: list[float] = []  # V, to be published; NaN: lost or not valid

    def take(self) -> Iterator[tuple[float, dict[str, Any]]]:
        """The next reading if it is there; a device that cannot be polled is waited for."""
        reading = self._device.poll()
        if reading is not None:
            self._number += reading.lost + 1
            self.fresh += [math.nan] * min(reading.lost, MOST_MISSING)
            self.fresh.append(reading.signal)
            info = {"publication_sequence_number": self._number, "source_timestamp": time.time_ns()}
            yield reading.signal, info


class DeviceController(DeviceNode, Controller):
    """The controller with a device; it publishes `spool_position` and `valve_voltage` after each sample.

    A device that cannot be polled makes the loop wait: for part of a period after a reading the node serves
    others, then it waits for the next. Such a device shares its process with no other.
    """

    table = (*CONTROLLER, *DEVICE)
    live = frozenset(LIVE | OWN - {"sample_period"})

    def __init__(self, alone: bool = True, **options: Any) -> None:
        self._ready_at = 0.0  # s, from when on the next reading is waited for
        self._asked_at = 0.0  # s, when it was last asked for
        self._begun = False
        self._given: list[float] = []  # V, to be published
        super().__init__(alone=alone, **options)

    def _build(self, values: Values) -> Any:
        self.refuse_changes(values)
        if not (drivers.device(values).polled or self._alone):
            raise ParameterError(
                f"driver is '{values['driver']}', which waits for its device and would hold up the other "
                "valves of the process; give this valve a controller of its own"
            )
        if values["lockstep"]:
            raise ParameterError("lockstep is true, but a device keeps its own time; set lockstep to false")
        return super()._build(values)

    def _apply(self, values: Values, built: Any) -> None:
        self.use(values)
        super()._apply({name: value for name, value in values.items() if name in OWN}, built)

    # Life

    def open(self) -> None:
        """Create publishers and subscriptions."""
        super().open()
        self._positions = self.create_publisher(Float64, "spool_position", SAMPLES)
        self._send_position = sender(self._positions)

    def _source(self, qos: QoSProfile) -> Any:
        self._from_device = DeviceReadings(self.device)
        return self._from_device

    def begin(self) -> None:
        """Start from rest; the output is switched on when the loop runs."""
        self._begun, self._ready_at, self._told = False, 0.0, ()
        super().begin()
        self._from_device.fresh.clear()

    def end(self) -> None:
        """Give 0 V and switch the output off."""
        super().end()
        self.device.enable(False)
        self._publish_signals()

    # Work

    def inputs(self) -> Sequence[PolledSubscription]:
        """None: commands wait for the device's reading."""
        return ()

    def due(self) -> float:
        """Time [s] from which the device is asked for a reading, or there is something else to do."""
        if not self.working:
            return super().due()
        ready = max(self._ready_at, self.device.due())
        return min(ready, super().due()) if self._begun else 0.0

    def fileno(self) -> int:
        """File of the device."""
        return self.device.fileno() if self.working and self._begun else -1

    def work(self) -> bool:
        """Answer a reading that has come."""
        if not self.working:
            return False
        if not self._begun:
            self._begun = True
            self.device.enable(True)
        before = self._supervisor.memory.samples
        self._asked_at = time.monotonic()
        super().work()
        waits = not self.device.polled and self._supervisor.memory.samples != before
        self._ready_at = self._timing.arrivals[-1] + SERVING * self._period if waits else 0.0
        return True

    def _stood_still(self, now: float) -> bool:
        """Whether this process stood still; a wait for the device, in which time goes by too, is none."""
        return super()._stood_still(now if self.device.polled else self._asked_at)

    def _give_voltage(self, voltage: float) -> None:
        self.device.write(voltage)
        self._published = time.time_ns()
        self._given.append(voltage)

    def _publish_signals(self) -> None:
        """Publish readings and voltages that the topics do not have yet."""
        for numbers, send in (
            (self._from_device.fresh, self._send_position),
            (self._given, self._send_voltage),
        ):
            for one in numbers:
                send(encoded(one))
            numbers.clear()

    def report(self) -> None:
        """Publish the sample on the topics, then what a controller reports."""
        if self._device is not None:
            self._publish_signals()
            conditions = self._device.conditions() if self.working else ()
            safe = any(condition.level == "safe" for condition in conditions)
            if self.differ(conditions) and self._may_tell(safe, "device"):
                self.tell(conditions, "device: ")
                self._publish_diagnostics()
        super().report()

    def _give_way(self, several: bool) -> None:
        """Go on: the device is this controller's, whoever publishes voltages."""

    def _status(self) -> tuple[bytes, str]:
        level, text = super()._status()
        levels = [level, *(LEVELS[condition.level] for condition in self._told)]
        return max(levels), "; ".join([text, *(condition.text for condition in self._told)])

    def _figures(self) -> dict[str, Any]:
        values = {**super()._figures(), "driver": word(self.device_values, "driver")}
        names = [*self._supervisor.conditions, *(condition.name for condition in self._told)]
        values["conditions"] = ", ".join(names)
        if self._device is not None:
            values["lost"] = self._device.lost
            values["late"] = self._device.late
            values["reopened"] = self._device.reopened
        return values
