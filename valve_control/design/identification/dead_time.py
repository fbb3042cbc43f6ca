# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Divides the dead time of a response between actuator and sensor, which readings alone do not tell apart.

The dead time of the actuator lies before the spool: the true spool is late by it, and so is the reading. That
of the sensor lies behind the spool: the reading alone is late. A law that takes one for the other holds the
true spool off by the dead time in question.
"""

import math

from valve_control.control.analysis.timing import Spread
from valve_control.parameter import Parameter

OF_SENSOR = Parameter("--sensor-delay", 0.0, "s", "dead time of an LVDT with its converter", 0.0, 1.0)
LEAST = 1e-6  # s  that any test tells


def notes(total: float, sensor: float) -> list[str]:
    """Where a ``total`` dead time [s] is counted, and the error that a wrong choice makes, as a sentence."""
    if total - sensor < LEAST:
        return []
    late = f"{1e3 * (total - sensor):.3g} ms"
    return [
        f"{late} of dead time count as the actuator's for the laws (--sensor-delay says how much is the "
        f"sensor's); if this is wrong, the true spool deviates by its velocity times {late}"
    ]


def way_notes(way: Spread) -> list[str]:
    """A sentence about the time from a reading to its voltage, if it is known."""
    if not math.isfinite(way.p50):
        return []
    return [
        f"voltages were sent {1e3 * way.p50:.2g} ms after their readings (median; 99 %: "
        f"{1e3 * way.p99:.2g} ms): middleware and controller add this dead time, which is not the valve's"
    ]
