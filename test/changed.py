# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Values of parameter tables with changes, in which ``a__b`` stands for ``a.b``."""

import math

import numpy as np

from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated


def dotted(changes):
    return {name.replace("__", "."): value for name, value in changes.items()}


def values(table, **changes):
    return updated(table, defaults(table), dotted(changes))


def controller(**changes):
    return values(CONTROLLER, **changes)


def supervisor(*note, **changes):
    """One that has these parameters."""
    made, own = Supervisor(*note), controller(**changes)
    made.apply(own, build.law_params(own))
    return made


def valve(**changes):
    return values(VALVE, **changes)


W = 2.0 * math.pi * 12.0
THIRD_ORDER = {  # 12 Hz with a damping of 0.9, and a pole at 60 Hz
    "valve": "custom",
    "numerator": [1.3 * W * W],
    "denominator": np.polymul([1.0, 1.8 * W, W * W], [1.0 / (2.0 * math.pi * 60.0), 1.0]).tolist(),
    "friction.coulomb": 0.6,
    "lvdt.noise": 0.008,
    "lvdt.delay": 0.0004,
}
