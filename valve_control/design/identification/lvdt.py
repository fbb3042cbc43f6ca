# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Estimates noise and converter step of an LVDT from its readings."""

import math
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats

DIFFERENCE = 4  # order of the differences that noise is told by: of a motion of 10 Hz at 1 kHz 1.6e-5 is left
WINDOW = 100  # differences in one of the windows whose median counts
LEAST_VALUES = 5  # different readings, to tell a step
STEP_ERROR = 0.05  # of a step, by which readings may lie beside its multiples


class Lvdt(NamedTuple):
    """What the readings tell of the LVDT."""

    noise: float  # V  standard deviation, without what the converter's steps add; 0.0: hidden in a step
    resolution: float  # V  step of the converter; 0.0: none


def observe(position: Floats) -> Lvdt:
    """Noise and step of the readings ``position`` [V] of a test, at rest or in motion; NaN: lost.

    White noise of variance 1 makes differences of order n with variance binomial(2n, n); a motion that is
    slow beside the sampling leaves nothing in them. The median over windows leaves out those of a faster one.
    """
    resolution = step(position)
    differences = np.diff(position, DIFFERENCE)
    differences = differences[np.isfinite(differences)]
    if len(differences) < WINDOW:
        return Lvdt(0.0, resolution)
    windows = differences[: len(differences) // WINDOW * WINDOW].reshape(-1, WINDOW)
    variance = float(np.median(np.mean(windows**2, axis=1))) / math.comb(2 * DIFFERENCE, DIFFERENCE)
    return Lvdt(math.sqrt(max(0.0, variance - resolution**2 / 12.0)), resolution)


def step(position: Floats) -> float:
    """Step [V] of which all readings ``position`` [V] are multiples, up to a constant; 0.0: there is none."""
    values = np.unique(position[np.isfinite(position)])
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * float(np.max(np.abs(values), initial=0.0))]
    if len(gaps) < LEAST_VALUES - 1:
        return 0.0
    smallest = float(np.min(gaps))
    counts = np.rint(gaps / smallest)
    found = float(np.sum(gaps) / np.sum(counts))
    return found if float(np.max(np.abs(gaps / found - counts))) <= STEP_ERROR else 0.0
