# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Limits the voltage as the amplifier that drives the solenoid does."""


def saturate(voltage: float, limit: float) -> float:
    """Limit ``voltage`` [V] to ±``limit`` [V] (u_max)."""
    if voltage > limit:
        return limit
    if voltage < -limit:
        return -limit
    return voltage
