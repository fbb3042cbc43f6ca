# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Derives initial values and bounds of the adaptive laws' estimates from identified models."""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification.bode import held_response
from valve_control.design.identification.rational import Fit, fit
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError

BANDS = (1.5, 2.0, 3.0, 4.5, 6.5, 10.0, 15.0)  # times the frequency of -90°
GAINS = (0.67, 1.5)  # of a valve over that of its model, 3.5 dB
SPEEDS = (0.8, 1.25)  # likewise
MARGIN = 1.25  # factor beyond what was found, for what a test on one day does not show
OFFSET = 0.5  # of u_max, the constant disturbance that the estimates can take up


class Suggestion(NamedTuple):
    """Initial θ = [a1, a0, b0, b0·dn] of (4), and its bounds (5)."""

    initial: list[float]
    lower: list[float]
    upper: list[float]


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
    seen = [centre, centre - spread, centre + spread]
    if best.order > 2 and best.corners.minus_90 is not None:
        for factor in BANDS:
            made = _up_to(measured, best, factor * best.corners.minus_90)
            if made is not None:
                seen.append(made)
    lower = np.min(seen, axis=0) / MARGIN
    upper = np.max(seen, axis=0) * MARGIN
    # An interval wider than the estimate itself says nothing about its lower end.
    lower = np.maximum(lower, 0.2 * centre)
    offset = OFFSET * u_max * b0
    return Suggestion(_rounded([*centre, 0.0]), _rounded([*lower, -offset]), _rounded([*upper, offset]))


def around(model: TransferFunction, u_max: float) -> Suggestion:
    """θ(0) of a ``model`` of second order that was not measured; bounds of the valves near it.

    These have GAINS times its gain and SPEEDS times its speed, with the margin that measured ones get too.
    """
    (b0,), (_, a1, a0) = model
    corners = [[a1 * s, a0 * s**2, b0 * g * s**2] for g in GAINS for s in SPEEDS]
    lower = np.min(corners, axis=0) / MARGIN
    upper = np.max(corners, axis=0) * MARGIN
    offset = OFFSET * u_max * b0
    return Suggestion(_rounded([a1, a0, b0, 0.0]), _rounded([*lower, -offset]), _rounded([*upper, offset]))


def _up_to(measured: Response, best: Fit, highest: float) -> Floats | None:
    """a1, a0, b0 of the second-order model nearest to ``best`` up to ``highest`` [Hz]."""
    lowest = float(measured.frequency[0])
    highest = min(highest, float(measured.frequency[-1]))
    if highest <= 3.0 * lowest:
        return None
    frequency = np.geomspace(lowest, highest, 30)
    value = held_response(best.model, frequency, measured.period)
    exact = Response(
        frequency, value, 1e-6 * np.abs(value), np.ones(30), measured.period, measured.method, ()
    )
    try:
        b0, a1, a0 = fit(exact, 2, relative=True).values
    except ParameterError:
        return None
    return np.array([a1, a0, b0])


def _rounded(values: list[float]) -> list[float]:
    return [float(f"{v:.6g}") for v in values]
