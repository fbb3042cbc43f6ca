# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the flow through an orifice, turbulent at large and laminar at small pressure differences."""

import math
from typing import NamedTuple


class Flow(NamedTuple):
    """Flow through an orifice and what a small change of the pressure difference adds to it."""

    flow: float  # m³/s
    conductance: float  # m³/s/Pa  derivative of the flow with respect to the pressure difference


def flow(coefficient: float, difference: float, laminar: float) -> Flow:
    """Flow at a pressure ``difference`` [Pa], of its sign; ``coefficient`` in m³/s/√Pa.

    q = k·Δp/(Δp² + Δp_l²)^¼: k·√Δp beyond the ``laminar`` pressure Δp_l [Pa], k·Δp/√Δp_l below it, smooth
    in between, so that the derivative at 0 is finite (Merritt 1967, section 3.3: at small Reynolds numbers
    the flow through an orifice is laminar).
    """
    squares = difference * difference + laminar * laminar
    root = math.sqrt(squares)
    scale = coefficient / math.sqrt(root)
    slope = scale * (0.5 * difference * difference + laminar * laminar) / squares
    return Flow(scale * difference, slope)


def opening(spool: float, overlap: float) -> float:
    """Opening of an edge, 0 to 1, at the ``spool`` position (share of its stroke, positive: towards open).

    ``overlap`` (share of the stroke): dead zone; negative, the edge is open in the middle.
    """
    return max(0.0, min(1.0, (spool - overlap) / (1.0 - overlap)))
