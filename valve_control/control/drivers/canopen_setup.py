# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""How a CiA 408 valve is found and configured, in pre-operational, by its object dictionary.

Objects 0x14xx to 0x1Axx, 0x1016 and 0x1017 are those of CiA 301, 0x6040 to 0x6311 those of CiA 408.
"""

import contextlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from valve_control.control.drivers.driver import DriverError

if TYPE_CHECKING:
    from valve_control.control.drivers.can_bus import CanNode

PROFILE = 408
INVALID, NO_REMOTE = 1 << 31, 1 << 30  # bits of a PDO's identifier
ON_SYNC, AT_ONCE = 1, 255  # transmission types
CONTROL, SETPOINT = 0x6040_00_10, 0x6300_01_10  # index, subindex and bits
STATUS, ACTUAL = 0x6041_00_10, 0x6301_01_10


def find(node: "CanNode", settings: Mapping[str, Any]) -> int:
    """Counts of 100 %. Raises DriverError if the node is none of CiA 408."""
    node.command("PRE-OPERATIONAL")
    try:
        profile = node.get(0x1000, 0, "I") & 0xFFFF
    except (DriverError, LookupError):
        raise DriverError(
            f"node {node.node} does not answer on {settings['channel']}; check canopen.node, "
            "canopen.bitrate, supply, wiring and terminating resistors"
        ) from None
    if profile != PROFILE:
        raise DriverError(f"node {node.node} has the device profile {profile}; it must have {PROFILE}")
    reference = int(settings["reference"])
    if not reference:
        try:
            reference = node.get(0x6311, 1, "h")
        except LookupError as error:
            raise DriverError(f"{error}; set canopen.reference to its counts of 100 %") from error
    if reference <= 0:
        raise DriverError(f"node {node.node} has {reference} in 0x6311:01; set canopen.reference")
    return reference


def configure(node: "CanNode", settings: Mapping[str, Any]) -> tuple[bool, int]:
    """Set modes, PDOs and watchdogs, start the node. Raises DriverError.

    Returns whether it watches this driver, and the node id whose heartbeat it wants for that, 0 for none.
    """
    node.command("PRE-OPERATIONAL")
    node.bus_off = False
    try:
        node.put(0x6040, 0, "H", 0)
        for index, name in ((0x6042, "device_mode"), (0x6043, "control_mode")):
            if settings[name]:
                node.put(index, 0, "b", settings[name])
        _map(node, 0x1400, 0x200, ON_SYNC if settings["on_sync"] else AT_ONCE, (CONTROL, SETPOINT))
        _map(node, 0x1800, 0x180, ON_SYNC, (STATUS, ACTUAL))
        watched = _watch(node, round(1e3 * settings["watchdog"]))
        node.put(0x1017, 0, "H", round(1e3 * settings["heartbeat"]))
    except LookupError as error:
        raise DriverError(str(error)) from error
    node.pump(0.0)
    node.command("OPERATIONAL")
    return watched


def _map(node: "CanNode", index: int, base: int, kind: int, objects: tuple[int, ...]) -> None:
    """Configure the first PDO of one direction: transmission type and mapped objects."""
    identifier = base + node.node
    node.put(index, 1, "I", identifier | INVALID | NO_REMOTE)
    node.put(index, 2, "B", kind)
    node.put(index + 0x200, 0, "B", 0)
    for sub, mapped in enumerate(objects, 1):
        node.put(index + 0x200, sub, "I", mapped)
    node.put(index + 0x200, 0, "B", len(objects))
    node.put(index, 1, "I", identifier | NO_REMOTE)


def _watch(node: "CanNode", milliseconds: int) -> tuple[bool, int]:
    """Set the time after which the valve misses its set point or, if it cannot, a heartbeat; 0: never.

    Returns whether it watches, and the node id of the heartbeat, 0 for none.
    """
    own = 127 if node.node != 127 else 126
    for index, sub, form, value in (
        (0x1400, 5, "H", milliseconds),
        (0x1016, 1, "I", own << 16 | milliseconds),
    ):
        with contextlib.suppress(LookupError):
            node.put(index, sub, form, value)
            return milliseconds > 0, own if index == 0x1016 and milliseconds else 0
    return False, 0
