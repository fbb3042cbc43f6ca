# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the signals from which a law starts: reading, voltage, reference and velocity."""

from typing import NamedTuple


class Start(NamedTuple):
    """Signals at the moment when a law starts or takes over."""

    measurement: float  # V    LVDT reading y(0)
    voltage: float  # V    voltage applied until now
    reference: float  # V    x_vd(0); equal to the reading for a start from rest
    reference_rate: float  # V/s  dx_vd(0)/dt
    velocity: float  # V/s  spool velocity, as well as it is known
