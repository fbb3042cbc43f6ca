# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A managed node that has a device: it is open from the configuration to the clean-up."""

from collections.abc import Iterable
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

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._device: Device | None = None  # None: it is not open
        self._refusal = ""  # why it could not be opened
        self._starts = False  # by itself, which ends the process with the reason
        self._told: tuple[Condition, ...] = ()
        super().__init__(*arguments, **options)

    def device_values(self) -> Values:
        """The parameters in use."""
        raise NotImplementedError

    def refuse_changes(self, fixed: Iterable[str], values: Values) -> None:
        """Raise ParameterError if ``values`` change one of the ``fixed`` parameters of an open device."""
        if self._device is None:
            return
        former = self.device_values()
        changed = [name for name in fixed if values[name] != former[name]]
        if changed:
            raise ParameterError(f"{changed[0]} of an open device does not change; clean the node up first")

    def differ(self, conditions: tuple[Condition, ...]) -> bool:
        """Whether these are other conditions than those that were told last."""
        return [c.name for c in conditions] != [c.name for c in self._told]

    def tell(self, conditions: tuple[Condition, ...], prefix: str = "") -> None:
        """Log the conditions that are new."""
        known = {condition.name for condition in self._told}
        for condition in conditions:
            if condition.name in known:
                continue
            if condition.level == "safe":
                self.get_logger().error(prefix + condition.text)
            else:
                self.get_logger().warning(prefix + condition.text)
        self._told = conditions

    def autostart(self) -> None:
        """Configure and activate. Raises ParameterError if the device cannot be opened."""
        self._starts = True
        self.trigger_configure()
        self._starts = False
        if self._refusal:
            raise ParameterError(self._refusal)
        self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the device."""
        device = drivers.device(self.device_values())
        try:
            device.open()
        except DriverError as error:
            self._refusal = str(error)
            if not self._starts:
                self.get_logger().error(self._refusal)
            return TransitionCallbackReturn.FAILURE
        self._device, self._refusal = device, ""
        return super().on_configure(state)

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
