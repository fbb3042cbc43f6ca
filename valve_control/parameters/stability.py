"""Checks whether sample period, gains and valve fit together: poles of the sampled loop.

The law is closed around the model that it believes in, with a margin; and, where a valve is known, around
that valve: its order, gain, dead time and flow force. Friction, resolution and saturation have no poles:
their effect shows in a run, simulation/offline.py.
"""

import cmath
import math
from typing import Any

from valve_control.laws.law import Law
from valve_control.parameters import linear_loop
from valve_control.plant import valve
from valve_control.plant.models import TransferFunction

GAIN_MARGIN = 1.25  # of b0; the real valve's b0 lies that far from θ(0), and so does (2)
MOST_DELAY = 50.0  # periods of dead time; more is left to the run


FREE = valve.Disturbance(
    coulomb=0,
    static_ratio=1,
    stribeck_velocity=1,
    velocity_scale=1,
    presliding=0,
    flow_force=0,
    offset=0,
    stiffness_drift=0,
    gain_drift=0,
)  # of friction and of everything else
IDEAL = valve.Lvdt(0.0, 0.0, 0.0, 0.0)


def spectral_radius(law: Law, params: Any, theta: tuple[float, ...]) -> float:
    """Largest modulus of the loop's poles, estimates frozen, on the model s² + a1·s + a0 with gain b0.

    A value of 1 or more means that this law is unstable on its own design model at this sample period.

    ``theta``: a1 [1/s], a0 [1/s²] and b0 [1/s²] of that model.
    """
    model = TransferFunction((theta[2],), (1.0, theta[0], theta[1]))
    plant = valve.design(model, params.period, params.u_max, 1.0, FREE, IDEAL)
    return abs(dominant_pole(law, params, plant))


def dominant_pole(law: Law, params: Any, plant: valve.Params) -> complex:
    """The pole of largest modulus of the sampled loop around ``plant``, without its friction and noise."""
    linear = linear_loop.linear_law(law, params, frozen=True)
    return complex(linear_loop.dominant_poles(linear, linear_loop.linear_valves([plant]))[0])


def warning(law: Law, params: Any) -> str:
    """One sentence if the sampled loop is unstable with b0 as assumed or 2 dB above it, else ""."""
    if law.model is None:
        return ""
    theta = law.model(params)
    radius = max(
        spectral_radius(law, params, theta),
        spectral_radius(law, params, (*theta[:2], GAIN_MARGIN * theta[2])),
    )
    if radius < 1.0:
        return ""
    return (
        f"{law.name} with these gains is unstable, or within 2 dB of it, at a sample period of "
        f"{params.period:g} s (largest pole of the sampled loop: {radius:.3f}); {law.remedy}"
    )


def valve_warning(law: Law, params: Any, plant: valve.Params) -> str:
    """One sentence if the sampled loop around this very valve is unstable, else ""."""
    if not law.feedback or plant.lvdt.delay > MOST_DELAY:
        return ""
    pole = dominant_pole(law, params, plant)
    if abs(pole) <= 1.0 + 1e-6:
        return ""
    frequency = abs(cmath.phase(pole)) / (2.0 * math.pi * params.period)
    return (
        f"{law.name} with these gains is unstable on this valve (largest pole of the sampled loop: "
        f"{abs(pole):.3f}, at {frequency:.3g} Hz); lower the gains, or give the law this valve's parameters"
    )
