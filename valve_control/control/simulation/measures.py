# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes what is measured of each valve of a batch: sums updated at every sample, and results from them."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.analysis.indices import variation


class Now(NamedTuple):
    """The signals at one sample, from which measures are computed."""

    command: float  # V
    measurement: float  # V
    position: float  # V  true
    voltage: float  # V
    first: bool  # whether this is the first sample
    final: bool  # whether it is within the last two seconds
    u_max: float  # V


class Tally(NamedTuple):
    """Sums and extremes from which the indices I1 to I5 are computed."""

    e_max: float  # V
    e_final: float  # V   largest of the last two seconds
    e_squares: float  # V²
    true_max: float  # V   of the true position
    true_squares: float  # V²
    u_squares: float  # V²
    change_squares: float  # V²  of the voltage from sample to sample
    saturated: float  # -   samples at ±u_max
    voltage: float  # V   of the sample before


class Results(NamedTuple):
    """Indices, one entry per valve; NaN where a run did not stay finite."""

    e_M: Floats  # V  (I2)
    e_F: Floats  # V  (I3)
    e_rms: Floats  # V  (I1)
    u_rms: Floats  # V  (I4)
    c_u: Floats  # -  (I5)
    true_e_M: Floats  # V  of the true position
    true_e_rms: Floats  # V
    saturated: Floats  # -  share of the samples at ±u_max
    finite: npt.NDArray[np.bool_]


def count(t: Tally, now: Now) -> Tally:
    """``t`` after one more sample."""
    error = abs(now.measurement - now.command)
    true_error = abs(now.position - now.command)
    change = 0.0 if now.first else now.voltage - t.voltage
    return Tally(
        max(t.e_max, error),
        max(t.e_final, error if now.final else 0.0),
        t.e_squares + error * error,
        max(t.true_max, true_error),
        t.true_squares + true_error * true_error,
        t.u_squares + now.voltage * now.voltage,
        t.change_squares + change * change,
        t.saturated + (1.0 if abs(now.voltage) >= now.u_max else 0.0),
        now.voltage,
    )


def tallied(commands: Floats, signals: Floats, last_begin: int, u_max: float) -> Tally:
    """Tally of one run with its ``commands`` [V], n, and ``signals`` (n×3): position, reading, voltage [V].

    ``last_begin``: sample at which the last two seconds begin.
    """
    t = Tally(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(signals.shape[0]):
        position, reading, voltage = signals[k, 0], signals[k, 1], signals[k, 2]
        t = count(t, Now(commands[k], reading, position, voltage, k == 0, k >= last_begin, u_max))
    return t


def results(tallies: Floats, samples: int) -> Results:
    """Indices I1 to I5 from ``tallies`` (fields×N) of runs with ``samples`` samples."""
    t = Tally(*tallies)
    with np.errstate(divide="ignore", invalid="ignore"):
        finite = np.isfinite(t.e_squares + t.true_squares + t.u_squares)
        numbers = (
            t.e_max,
            t.e_final,
            np.sqrt(t.e_squares / samples),
            np.sqrt(t.u_squares / samples),
            variation(t.change_squares, t.u_squares, samples),
            t.true_max,
            np.sqrt(t.true_squares / samples),
            t.saturated / samples,
        )
    return Results._make([*(np.where(finite, column, np.nan) for column in numbers), finite])
