# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Values of parameter tables with changes, in which ``a__b`` stands for ``a.b``."""

from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.parameter import defaults, updated


def dotted(changes):
    return {name.replace("__", "."): value for name, value in changes.items()}


def values(table, **changes):
    return updated(table, defaults(table), dotted(changes))


def controller(**changes):
    return values(CONTROLLER, **changes)


def valve(**changes):
    return values(VALVE, **changes)
