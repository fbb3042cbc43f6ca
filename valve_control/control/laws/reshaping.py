# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reshapes a command into a feasible reference with two derivatives: trajectory reshaping (8)-(11).

In the paper's form a fast filter (8) brakes too late for the limit (6), and the reference overshoots.
The braking form has a damping of 1 at least, and keeps the rate so low that the reference can still stop at
the command within (6): a step is never overshot. The derivation is in docs/explanation/laws/reshaping.md.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from valve_control.control.laws.free import Free
from valve_control.control.plant.transfer_functions import D3FXE, LIKE, Scale, TransferFunction, slow_motion
from valve_control.parameter import Parameter, ParameterError, Table, Values, defaults, number, word


class Params(NamedTuple):
    """Second-order filter with limits on rate and acceleration, sampled every ΔT."""

    natural_frequency: float  # rad/s  omega_n of (8)
    damping: float  # -      xi_n of (8)
    max_rate: float  # V/s    bound (7)
    max_accel: float  # V/s²   bound (6)
    period: float  # s      ΔT
    braking: float = 0.0  # 1.0: the reference brakes in time; 0.0: the paper's form
    dead_time: float = 0.0  # s    by which the spool follows the reference later, of the actuator
    smoothing: float = 0.0  # 1/s  speed g of the filter behind (8), for a third derivative; 0.0: none


class State(NamedTuple):
    """The reference and its rate at this sample."""

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
    if abs(rate) > p.max_rate:
        accel = (math.copysign(p.max_rate, rate) - s.rate) / p.period  # (10)
    if p.braking > 0.0:
        rate = s.rate + accel * p.period
        ahead = command - s.reference - s.rate * p.period  # from the next sample on
        if rate > 0.0:
            most = braking_rate(p, ahead)
            if rate > most:
                accel = max((most - s.rate) / p.period, -p.max_accel)
        else:
            most = braking_rate(p, -ahead)
            if rate < -most:
                accel = min((-most - s.rate) / p.period, p.max_accel)
    return accel


def braking_rate(p: Params, ahead: float) -> float:
    """Highest rate [V/s] from which a reference can stop after ``ahead`` [V] within (6).

    It brakes at the limit for some samples, and then as (8) with a damping of 1 comes to rest. Up to the rate
    at which that takes over, (8) itself keeps it.
    """
    wn = p.natural_frequency
    change = p.max_accel * p.period
    slow = p.max_accel / wn
    if ahead * wn <= slow:
        return slow
    q = 1.0 / (wn * p.period)
    u = ahead / (change * p.period)
    n = math.floor(math.sqrt((q + 0.5) * (q + 0.5) + 2.0 * (u - q * q)) - (q + 0.5)) + 1.0
    return (wn * ahead + change * n * (1.0 + 0.5 * (n - 1.0) / q)) / (1.0 + n / q)


def braking_distance(p: Params, rate: float) -> float:
    """Way [V] that a reference of this ``rate`` [V/s] >= 0 needs to stop; 0 where (8) alone sees to it."""
    wn = p.natural_frequency
    change = p.max_accel * p.period
    beyond = rate - p.max_accel / wn
    if p.braking == 0.0 or beyond <= 0.0:
        return 0.0
    n = math.floor(beyond / change) + 1.0
    turns = wn * p.period
    return (rate * (1.0 + n * turns) - change * n * (1.0 + 0.5 * (n - 1.0) * turns)) / wn


def not_braked(p: Params, command: float, reference: float, rate: float, next_rate: float) -> float:
    """``command`` [V], or so much farther that the ``next_rate`` [V/s] of a reference is not braked."""
    after = reference + rate * p.period
    if next_rate > 0.0:
        way = braking_distance(p, next_rate)
        return max(command, after + way) if way > 0.0 else command
    way = braking_distance(p, -next_rate)
    return min(command, after - way) if way > 0.0 else command


def steady_command(p: Params, reference: float, rate: float) -> float:
    """Command [V] under which a reference [V] that moves at ``rate`` [V/s] keeps its rate, from (8)."""
    reference = unsmoothed(p, reference, rate)
    command = reference + 2.0 * p.damping / p.natural_frequency * rate
    return not_braked(p, command, reference, rate, rate)


def command_of(p: Params, position: float, rate: float, accel: float) -> float:
    """Command [V] under which the reference follows ``position`` [V] with its two derivatives: (8), inverted.

    The Euler step (11) holds the rate over a period, so that its own rate is that of the middle of it. The
    reference is ahead by the dead time of the actuator.
    """
    wn = p.natural_frequency
    position += (rate + 0.5 * accel * p.dead_time) * p.dead_time
    rate += accel * p.dead_time
    middle = rate + 0.5 * p.period * accel
    position = unsmoothed(p, position, middle)
    middle = unsmoothed(p, middle, accel)
    command = position + 2.0 * p.damping / wn * middle + accel / (wn * wn)
    return not_braked(p, command, position, middle, middle + accel * p.period)


def advance(p: Params, s: State, accel: float) -> State:
    """Reference at the next sample (11)."""
    return State(s.reference + s.rate * p.period, s.rate + accel * p.period)


def smoothed(p: Params, s: State, accel: float, smooth: float) -> tuple[float, float, float]:
    """Position [V], rate [V/s] and acceleration [V/s²] of a reference with a third derivative.

    ``smooth`` [V]: its position, which a first-order filter makes of the reference ``s`` with ``accel``
    [V/s²]. Without the filter it is the reference itself.
    """
    if p.smoothing > 0.0:
        rate = p.smoothing * (s.reference - smooth)
        return smooth, rate, p.smoothing * (s.rate - rate)
    return s.reference, s.rate, accel


def unsmoothed(p: Params, position: float, rate: float) -> float:
    """Position [V] of the reference that the filter makes ``position`` [V] with ``rate`` [V/s] of."""
    return position + rate / p.smoothing if p.smoothing > 0.0 else position


MOST_LEAD = 0.1  # s
AROUND = 1.1  # times the lag that a law knows, or once over it, that a tuner may choose as lead
PARAMETERS: Table = (
    Parameter(
        "reshaping.form",
        "paper",
        "",
        "paper: (8) to (11) as printed; braking: the reference brakes in time and never overshoots a "
        "step from rest; ξ_n is then at least 1 and ω_n at most 1/(ξ_n·ΔT)",
        choices=("paper", "braking"),
    ),
    Parameter("reshaping.natural_frequency", 314.0, "rad/s", "natural frequency ω_n of (8)", 1.0, 1e5),
    Parameter("reshaping.damping", 0.8, "-", "damping ratio ξ_n of (8)", 0.1, 10.0),
    Parameter("reshaping.max_rate", 250.0, "V/s", "largest reference rate, (7)", 0.1, 1e5),
    Parameter("reshaping.max_accel", 12000.0, "V/s²", "largest reference acceleration, (6)", 1.0, 1e7),
    Parameter(
        "reshaping.lead",
        0.0,
        "s",
        "lead of the command; 2·ξ_n/ω_n: by the lag of (8); 0.0: none",
        0.0,
        MOST_LEAD,
    ),
    Parameter("reshaping.lead_accel", 0.0, "-", "share of the acceleration in the lead; 0.0: none", 0.0, 1.0),
)


def limits(model: TransferFunction, u_max: float) -> Values:
    """Limits (6) and (7) for a valve with ``model`` and at most ``u_max`` [V].

    None where the defaults, which are those of the D3FXE, are within a factor LIKE of both, or where (1) does
    not describe the valve.
    """
    slow = slow_motion(model)
    if slow is None:
        return {}
    usual = defaults(PARAMETERS)
    wanted = {"reshaping.max_accel": slow.b0 * u_max, "reshaping.max_rate": slow.b0 * u_max / slow.a1}
    if all(1.0 / LIKE <= value / number(usual, name) <= LIKE for name, value in wanted.items()):
        return {}
    ranges = {p.name: (p.low, p.high) for p in PARAMETERS}
    return {name: float(f"{min(max(v, ranges[name][0]), ranges[name][1]):.4g}") for name, v in wanted.items()}


def at_period(period: float) -> Values:
    """Natural frequency for a sample ``period`` [s] at which the default one is too fast; none if it is not.

    It has the lead of two periods that ``frequency`` asks for.
    """
    usual = defaults(PARAMETERS)
    highest = number(usual, "reshaping.damping") / period
    if number(usual, "reshaping.natural_frequency") <= highest:
        return {}
    return {"reshaping.natural_frequency": float(f"{highest:.4g}")}


HIGHEST = 1200.0  # rad/s  that a tuner may choose
LEAD = Free("reshaping.lead", 0.0, 0.03, logarithmic=False, powers=(-1, 0))  # of a law that does not reshape
LEAD_ACCEL = Free("reshaping.lead_accel", 0.0, 1.0, logarithmic=False)


def frequency(values: Values, scale: Scale = D3FXE) -> Free:
    """The natural frequency that a tuner may choose with these ``values`` of the controller, on a valve.

    At the limit (6) the acceleration changes its sign where the reference will be at the command in
    2·ξ_n/ω_n, and the reference answers a period later. With less than two periods of lead it takes long to
    rest after a step, with one and a third it swings for ever: so ω_n is at most ξ_n/ΔT.
    """
    high = min(HIGHEST * scale.speed, _damping(values) / number(values, "sample_period"))
    if _brakes(values):
        high = min(high, _fastest(values))
    return Free("reshaping.natural_frequency", min(100.0 * scale.speed, 0.25 * high), high)


def filter_of(values: Values) -> tuple[float, float]:
    """Natural frequency [rad/s] and damping of (8) in the form that ``values`` of the controller choose."""
    wn = number(values, "reshaping.natural_frequency")
    return (min(wn, _fastest(values)) if _brakes(values) else wn), _damping(values)


def _brakes(values: Values) -> bool:
    return word(values, "reshaping.form") == "braking"


def _damping(values: Values) -> float:
    damping = number(values, "reshaping.damping")
    return max(1.0, damping) if _brakes(values) else damping


def _fastest(values: Values) -> float:
    """Natural frequency [rad/s] of the braking form from which on (8) turns back before it is at rest."""
    return 1.0 / (_damping(values) * number(values, "sample_period"))


def lag(values: Values) -> float:
    """Lag [s] of (8) behind a ramp."""
    wn, damping = filter_of(values)
    return 2.0 * damping / wn


def _within(whole: Callable[[Values], float], values: Values) -> float:
    """``whole`` lag [s] with these ``values``, as far as a lead around it is within its range."""
    return min(whole(values), MOST_LEAD / AROUND)


def lead(values: Values, scale: Scale = D3FXE, whole: Callable[[Values], float] = lag) -> Free:
    """The lead that a tuner may choose for a law that reshapes, in lags of (8).

    ``whole``: lag [s] of a law that knows more of it than that of (8). The lead is counted in it and stays
    near it then: another one is an error of the reference, which slow motions do not show to a tuner.
    """
    if whole(values) > lag(values):
        return Free("reshaping.lead", 1.0 / AROUND, AROUND, unit=partial(_within, whole))
    longest = 2.0 * _damping(values) / frequency(values, scale).low
    return Free("reshaping.lead", 0.25, max(0.5, min(6.0, MOST_LEAD / longest)), unit=lag)


def build(values: Values) -> Params:
    """Reshaping filter from the controller's values. Raises ParameterError."""
    wn, damping = filter_of(values)
    period = number(values, "sample_period")
    # The Euler step (11) of the filter (8) is stable below this frequency.
    limit = 2.0 * damping if damping <= 1.0 else 2.0 * (damping - math.sqrt(damping**2 - 1.0))
    if wn * period >= limit and not _brakes(values):
        raise ParameterError(
            f"reshaping.natural_frequency is {wn:g} rad/s; at a sample period of {period:g} s and "
            f"damping {damping:g} it must be below {limit / period:g} rad/s, or sample_period below "
            f"{1e3 * limit / wn:.3g} ms"
        )
    return Params(
        wn,
        damping,
        number(values, "reshaping.max_rate"),
        number(values, "reshaping.max_accel"),
        period,
        1.0 if _brakes(values) else 0.0,
    )
