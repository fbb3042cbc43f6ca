# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists all kinds of driver by name: those of this package, and those of other packages that are installed.

Another package adds a kind by an entry point of the group ``valve_control.drivers`` that names a ``Kind``.
"""

from valve_control.control import plugins
from valve_control.control.drivers import canopen_408, modbus, serial_card
from valve_control.control.drivers.driver import PACKAGE, Kind

GROUP = "valve_control.drivers"
BUILT_IN: tuple[Kind, ...] = (serial_card.KIND, canopen_408.KIND, modbus.KIND)
RESERVED = ("simulated",)  # of the valve that `control/parameters/drivers.py` adds


def accepted(found: object, taken: dict[str, Kind]) -> Kind:
    """``found`` if it is a kind of driver whose name is free. Raises PluginError."""
    kind = plugins.check(found, Kind)
    if kind.name in taken or kind.name in RESERVED:
        package = taken[kind.name].package if kind.name in taken else PACKAGE
        raise plugins.PluginError(f"the name is taken by a driver of {package}")
    return kind


KINDS = {kind.name: kind for kind in BUILT_IN}
LEFT_OUT = plugins.add(GROUP, "driver", accepted, KINDS)  # why, as a sentence
