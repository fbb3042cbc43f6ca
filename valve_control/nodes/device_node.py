# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A managed node that has a device: it is open from the configuration to the clean-up."""

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from valve_control.control.drivers.device import Device
from valve_control.control.drivers.driver import Condition, DriverError
from valve_control.control.parameters import drivers
from valve_control.nodes.lifecycle import Managed
from valve_control.parameter import ParameterError, Values

LEVELS = {"degraded": DiagnosticStatus.WARN, "safe": DiagnosticStatus.ERROR}
MOST_MISSING = 100  # readings that are published as NaN; a larger gap is silence, which the controller finds


class DeviceNode(Managed):
    """Opens the device of ``device_values``; without it the node stays unconfigured."""

    live: frozenset[str]  # parameters that an open device may change

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.device_values: Values = {}  # in use
        self._device: Device | None = None  # None: it is not open
        self._told: tuple[Condition, ...] = ()
        super().__init__(*arguments, **options)

    @property
    def device(self) -> Device:
        """The device, which is open."""
        assert self._device is not None
        return self._device

    def refuse_changes(self, values: Values) -> None:
        """Raise ParameterError if ``values`` change a parameter of an open device that is not ``live``."""
        former = self.device_values if self._device is not None else {}
        for name, value in former.items():
            if name not in self.live and values[name] != value:
                raise ParameterError(f"{name} of an open device does not change; clean the node up first")

    def use(self, values: Values) -> None:
        """Take ``values`` into use for the device."""
        self.device_values = values
        if self._device is not None:
            self._device.limit(*drivers.sides(values))

    def differ(self, conditions: tuple[Condition, ...]) -> bool:
        """Whether these are other conditions than those that were told last."""
        return [c.name for c in conditions] != [c.name for c in self._told]

    def tell(self, conditions: tuple[Condition, ...], prefix: str = "") -> None:
        """Log the conditions that are new."""
        known = {condition.name for condition in self._told}
        new = [condition for condition in conditions if condition.name not in known]
        for name, level, text in new:
            if level == "safe":
                self.get_logger().error(f"{prefix}{name}: {text}")
            else:
                self.get_logger().warning(f"{prefix}{name}: {text}")
        self._told = conditions

    def autostart(self) -> None:
        """Configure and activate. Raises ParameterError if the device cannot be opened."""
        try:
            self._acquire()
        except DriverError as error:
            raise ParameterError(str(error)) from error
        super().autostart()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the device."""
        try:
            self._acquire()
        except DriverError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def _acquire(self) -> None:
        if self._device is None:
            device = drivers.device(self.device_values)
            device.open()
            self._device = device

    def close(self) -> None:
        """Close the device too."""
        super().close()
        self._release()

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the device too, whatever the state was."""
        done = super().on_shutdown(state)
        self._release()
        return done

    def finish(self) -> None:
        """Switch off and close the device from whatever state the node is in."""
        super().finish()
        self._release()

    def _release(self) -> None:
        if self._device is not None:
            self._device.close()
            self._device = None
