"""The small vocabulary that all laws share: where they start, and the limits of the amplifier."""

from typing import NamedTuple


class Start(NamedTuple):
    """Where a law starts or takes over."""

    measurement: float  # V    LVDT reading y(0)
    voltage: float  # V    voltage applied until now
    reference: float  # V    x_vd(0); equal to the reading for a start from rest
    reference_rate: float  # V/s  dx_vd(0)/dt
    velocity: float  # V/s  spool velocity, as well as it is known


def saturate(voltage: float, limit: float) -> float:
    """Limit ``voltage`` [V] to ±``limit`` [V] (u_max)."""
    if voltage > limit:
        return limit
    if voltage < -limit:
        return -limit
    return voltage
