# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Derives initial values and bounds of the adaptive laws' estimates from identified models."""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.identification.bode_fit import Fit, exact, fit
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError, Values

BANDS = (1.5, 2.0, 3.0, 4.5, 6.5, 10.0, 15.0)  # times the frequency of -90°
GAINS = (0.67, 1.5)  # of a valve over that of its model, 3.5 dB
SPEEDS = (0.8, 1.25)  # likewise
MARGIN = 1.25  # factor beyond what was found, for what a test on one day does not show
LEAST = 0.2  # of the estimate: an interval wider than the estimate says nothing about its lower end
OFFSET = 0.5  # of u_max, the constant disturbance that the estimates can take up


class Suggestion(NamedTuple):
    """Initial θ = [a1, a0, b0, b0·dn] of (4), and its bounds (5)."""

    initial: list[float]
    lower: list[float]
    upper: list[float]

    def parameters(self, law: str) -> Values:
        """Parameters of an adaptive ``law``."""
        names = ("theta_initial", "theta_min", "theta_max")
        return {f"{law}.{name}": list(values) for name, values in zip(names, self, strict=True)}


def suggest(measured: Response, second: Fit, best: Fit, u_max: float) -> Suggestion:
    """θ(0) from the second-order fit; bounds that hold every second-order model the valve may look like.

    These are: the ends of the fit's confidence intervals, and the second-order models nearest to the ``best``
    fit up to several frequencies, since a command with slow motions and one with fast motions see different
    ones. A margin of 25 % comes on top. Raises ParameterError for a valve that moves against its voltage.
    """
    b0, a1, a0 = (float(v) for v in second.values[:3])
    if b0 <= 0.0:
        raise ParameterError(
            f"the static gain is {second.model.static_gain:.3g} V/V: the spool moves against the voltage; "
            "turn the sign of one of them"
        )
    centre = np.array([a1, a0, b0])
    spread = second.bounds[[1, 2, 0]]
    models = [centre, centre - spread, centre + spread]
    if best.order > 2 and best.corners.minus_90 is not None:
        for factor in BANDS:
            models += _up_to(measured, best, factor * best.corners.minus_90)
    return _bounded(centre, models, u_max)


def around(model: TransferFunction, u_max: float) -> Suggestion:
    """θ(0) of a ``model`` of second order that was not measured; bounds of the valves near it.

    These have GAINS times its gain and SPEEDS times its speed, with the margin that measured ones get too.
    """
    (b0,), (_, a1, a0) = model
    corners = [np.array([a1 * s, a0 * s**2, b0 * g * s**2]) for g in GAINS for s in SPEEDS]
    return _bounded(np.array([a1, a0, b0]), corners, u_max)


def _bounded(centre: Floats, models: list[Floats], u_max: float) -> Suggestion:
    """Estimates that begin at ``centre`` (a1, a0, b0) and hold all ``models``."""
    lower = np.maximum(np.min(models, axis=0) / MARGIN, LEAST * centre)
    offset = OFFSET * u_max * float(centre[2])
    rows = ([*centre, 0.0], [*lower, -offset], [*(np.max(models, axis=0) * MARGIN), offset])
    return Suggestion(*([float(f"{v:.6g}") for v in row] for row in rows))


def _up_to(measured: Response, best: Fit, highest: float) -> list[Floats]:
    """a1, a0, b0 of the second-order model nearest to ``best`` up to ``highest`` [Hz]; empty: none is."""
    lowest = float(measured.frequency[0])
    highest = min(highest, float(measured.frequency[-1]))
    if highest <= 3.0 * lowest:
        return []
    there = np.geomspace(lowest, highest, 30)
    try:
        b0, a1, a0 = fit(exact(best.model, there, measured.period, 0.0, 1e-6), 2).values
    except ParameterError:
        return []
    return [np.array([a1, a0, b0])]
