# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks whether sample period, gains and valve fit together: poles of the sampled loop.

The law is closed around the model that it believes in, with a margin; and, where a valve is known, around
that valve: its order, gain, dead time and flow force. Friction, resolution and saturation have no poles:
their effect shows in a run, simulation/offline.py.
"""

import cmath
import math
from typing import Any

import numpy as np

from valve_control.control.compiling import explained
from valve_control.control.laws import linearisation
from valve_control.control.laws.law import Law
from valve_control.control.linear import linear_loop
from valve_control.control.linear.linear_loop import LinearValves
from valve_control.control.plant import registry, valve
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.parameter import Values, number

GAIN_MARGIN = 1.25  # of b0; the real valve's b0 lies that far from θ(0), and so does (2)
MOST_DELAY = 50.0  # periods of dead time; more is left to the run
FARTHEST = 40  # dB  by which a gain is changed to find one with which an unstable loop is stable
NARROW = 0.02  # of the law's range, over which the slope behind a curve counts
GRID = 2000  # parts of that range
FLAT = 1e-9  # -  slope that is rounding
STABLE = 1.0 + 1e-6  # largest modulus of a pole, with room for rounding


def believed(law: Law, params: Any) -> LinearValves:
    """The model that ``law`` believes in."""
    exact = law.sampled_model(params)
    if exact is not None:
        return linear_loop.undelayed(*exact)
    assert law.model is not None
    a1, a0, b0 = law.model(params)
    model = TransferFunction((b0,), (1.0, a1, a0))
    return linear_loop.linear_valves(
        [valve.design(model, params.period, params.u_max, 1.0, valve.NO_DISTURBANCE, IDEAL)]
    )


def pole_of(law: Law, params: Any, valves: LinearValves) -> complex:
    linear = linear_loop.linear_law(law, params, frozen=True)
    return complex(linear_loop.dominant_poles(linear, valves)[0])


def dominant_pole(law: Law, params: Any, plant: Any) -> complex:
    """The pole of largest modulus of the sampled loop around ``plant``, without its friction and noise."""
    return pole_of(law, params, linear_loop.linear_valves([plant]))


def warning(law: Law, params: Any) -> str:
    """One sentence if the sampled loop is unstable with b0 as assumed or 2 dB above it, else ""."""
    if law.model is None:
        return ""
    with explained(law.title):
        own = believed(law, params)
    at_rest, gained = (pole_of(law, params, own._replace(b=gain * own.b)) for gain in (1.0, GAIN_MARGIN))
    pole = max(at_rest, gained, key=abs)
    if abs(pole) < 1.0:
        return ""
    remedy = law.remedy if abs(at_rest) < 1.0 else _advice(law, params, own, law.remedy)
    return (
        f"{law.name} with these gains is unstable, or within 2 dB of it, at a sample period of "
        f"{params.period:g} s ({_largest(pole, params)}); {remedy}"
    )


def behind_curve(values: Values, plant: Any) -> list[Any]:
    """Valves that a law sees where the controller's ``values`` put the inverse of a curve before ``plant``.

    The valve with the least and with the largest mean slope of f(f⁻¹(G·v))/G over NARROW of the law's
    range: f is the plant's static curve, f⁻¹ the given inverse. In a narrower part a loop may swing, but not
    out of it. A flat part, across an overlap, has no loop and does not count. Without a curve, or if all is
    flat: the ``plant``. Raises ParameterError.
    """
    if not linearisation.is_on(values):
        return [plant]
    kind, limit = registry.plant_of(plant), number(linearisation.seen(values), "u_max")
    inverse = linearisation.inverse(values)
    grid = np.linspace(-limit, limit, GRID + 1)
    force = np.array([linearisation.value(inverse, float(v)) for v in grid])
    if kind.pull is not None:
        force = np.array([kind.pull(plant, float(u)) for u in force])
    steps = max(1, round(NARROW * GRID))
    slopes = (force[steps:] - force[:-steps]) / (grid[steps:] - grid[:-steps])
    slopes = slopes[slopes > FLAT]
    if not len(slopes):
        return [plant]
    ends = dict.fromkeys((float(np.min(slopes)), float(np.max(slopes))))
    return [kind.varied(plant, slope, 0.0, 1.0) for slope in ends]


def valve_warning(law: Law, params: Any, plant: Any, values: Values) -> str:
    """One sentence if the sampled loop around this very valve is unstable, else "".

    ``values``: of the controller, whose curve is a part of the loop. Raises ParameterError.
    """
    if not law.feedback or registry.linear(plant).lvdt.delay > MOST_DELAY:
        return ""
    several = [linear_loop.linear_valves([one]) for one in behind_curve(values, plant)]
    pole, valves = max(((pole_of(law, params, one), one) for one in several), key=lambda found: abs(found[0]))
    if abs(pole) <= STABLE:
        return ""
    return (
        f"{law.name} with these gains is unstable on this valve ({_largest(pole, params)}); "
        f"{_advice(law, params, valves, 'lower the gains')}, or give the law this valve's parameters"
    )


def _largest(pole: complex, params: Any) -> str:
    frequency = abs(cmath.phase(pole)) / (2.0 * math.pi * params.period)
    return f"largest pole of the sampled loop: {abs(pole):.3f}, at {frequency:.3g} Hz"


def stable_gains(law: Law, params: Any, valves: LinearValves) -> tuple[int | None, int | None]:
    """By how many dB the loop's gain has to fall, or to rise, until the unstable loop is stable; None: never.

    ``valves``: one. The loop is cut at the voltage, as for its margins (margins.py).
    """
    linear = linear_loop.linear_law(law, params, frozen=True)
    steps = np.arange(1, FARTHEST + 1)
    factors = 10.0 ** (np.concatenate([-steps, steps]) / 20.0)
    gained = LinearValves._make(np.repeat(field, len(factors), axis=0) for field in valves)
    gained = gained._replace(b=factors[:, None] * gained.b)
    poles = np.abs(linear_loop.dominant_poles(linear, gained)).reshape(2, -1)
    down, up = (int(steps[np.argmax(row)]) if np.any(row) else None for row in poles <= STABLE)
    return down, up


def _advice(law: Law, params: Any, valves: LinearValves, lower: str) -> str:
    """Which way the gains have to go until the loop around ``valves`` (one) is stable; ``lower``: down."""
    down, up = stable_gains(law, params, valves)
    if down is not None and (up is None or down <= up):
        return f"it is stable with {down} dB less gain in the loop: {lower}"
    if up is not None:
        return f"it is stable with {up} dB more gain in the loop: raise the gains"
    return "no gain in the loop makes it stable: choose gains for another model"
