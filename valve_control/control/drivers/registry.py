# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists all kinds of driver by name: those of this package, and those of other packages that are installed.

Another package adds a kind by an entry point of the group ``valve_control.drivers`` that names a ``Kind``.
"""

from importlib.metadata import EntryPoint, entry_points

from valve_control.control.drivers import canopen_408, modbus, serial_card
from valve_control.control.drivers.driver import Kind, KindError, check

GROUP = "valve_control.drivers"
BUILT_IN: tuple[Kind, ...] = (serial_card.KIND, canopen_408.KIND, modbus.KIND)
RESERVED = ("simulated",)  # of the valve that `control/parameters/drivers.py` adds


def _plugged_in(point: EntryPoint, taken: dict[str, Kind]) -> Kind:
    """The kind of ``point``. Raises KindError."""
    try:
        found = point.load()
    except Exception as error:
        raise KindError(f"it cannot be imported: {type(error).__name__}: {error}") from error
    kind = check(found)
    if kind.name in taken or kind.name in RESERVED:
        package = taken[kind.name].package if kind.name in taken else Kind._field_defaults["package"]
        raise KindError(f"the name is taken by a driver of {package}")
    return kind._replace(package=point.dist.name if point.dist is not None else point.module)


def _all() -> tuple[dict[str, Kind], dict[str, str]]:
    kinds = {kind.name: kind for kind in BUILT_IN}
    refused: dict[str, str] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        package = point.dist.name if point.dist is not None else point.module
        try:
            kind = _plugged_in(point, kinds)
        except KindError as error:
            refused[point.name] = f"the driver '{point.name}' of the package {package} is left out: {error}"
        else:
            kinds[kind.name] = kind
    return kinds, refused


KINDS, LEFT_OUT = _all()  # LEFT_OUT: why, as a sentence
