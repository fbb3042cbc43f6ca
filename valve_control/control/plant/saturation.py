# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Saturation of the voltage, as in the amplifier that drives the solenoid; laws and valves share it."""


def saturate(voltage: float, limit: float) -> float:
    """Limit ``voltage`` [V] to ±``limit`` [V] (u_max)."""
    if voltage > limit:
        return limit
    if voltage < -limit:
        return -limit
    return voltage
