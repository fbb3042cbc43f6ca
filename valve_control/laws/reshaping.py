"""Trajectory reshaping (8)-(11): a feasible reference with its two derivatives from a bare command."""

from typing import NamedTuple


class Params(NamedTuple):
    """Second-order filter with limits on rate and acceleration."""

    natural_frequency: float  # rad/s  omega_n of (8)
    damping: float  # -      xi_n of (8)
    max_rate: float  # V/s    bound (7)
    max_accel: float  # V/s²   bound (6)
    period: float  # s      ΔT


class State(NamedTuple):
    """Reference at this sample."""

    reference: float  # V    x_vd(k)
    rate: float  # V/s  dx_vd(k)/dt


def acceleration(p: Params, s: State, command: float) -> float:
    """Acceleration [V/s²] of the reference at this sample, within both limits: steps 1 to 3, (8)-(10)."""
    wn = p.natural_frequency
    accel = -2.0 * p.damping * wn * s.rate - wn * wn * (s.reference - command)  # (8)
    if accel > p.max_accel:  # step 2
        accel = p.max_accel
    elif accel < -p.max_accel:
        accel = -p.max_accel
    rate = s.rate + accel * p.period  # (9)
    if rate > p.max_rate:
        accel = (p.max_rate - s.rate) / p.period  # (10)
    elif rate < -p.max_rate:
        accel = (-p.max_rate - s.rate) / p.period  # (10)
    return accel


def steady_command(p: Params, reference: float, rate: float) -> float:
    """Command [V] under which a reference [V] that moves at ``rate`` [V/s] keeps its rate, from (8)."""
    return reference + 2.0 * p.damping / p.natural_frequency * rate


def advance(p: Params, s: State, accel: float) -> State:
    """Reference at the next sample (11)."""
    return State(s.reference + s.rate * p.period, s.rate + accel * p.period)
