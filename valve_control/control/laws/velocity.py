# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Estimates the spool velocity from readings: backward difference, low-pass (remark iv of section 3.1)."""

import math
from typing import NamedTuple


class Params(NamedTuple):
    """Discretised differentiator."""

    period: float  # s  ΔT
    smoothing: float  # -  share of the new difference, 1 - exp(-2*pi*f_c*ΔT)


class State(NamedTuple):
    """What the differentiator remembers from the last sample."""

    measurement: float  # V    reading at the sample before
    velocity: float  # V/s  filtered estimate


def design(cutoff: float, period: float) -> Params:
    """Differentiator with a low-pass of ``cutoff`` [Hz], sampled every ``period`` [s]; the pole is exact."""
    return Params(period, 1.0 - math.exp(-2.0 * math.pi * cutoff * period))


def step(p: Params, s: State, measurement: float) -> State:
    """Take in one reading [V]; ``velocity`` of the result is the estimate [V/s] at this sample."""
    difference = (measurement - s.measurement) / p.period
    return State(measurement, s.velocity + p.smoothing * (difference - s.velocity))
