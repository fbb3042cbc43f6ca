# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the performance indices I1 to I5 of section 4.1, errors and voltages of a run, and their table."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats

HEADER = f"{'':14}{'e_M [V]':>10}{'e_F [V]':>10}{'e_rms [V]':>11}{'u_rms [V]':>11}{'c_u':>9}"
PAUSE = 100.0  # periods without a message from which on none was sent, or the clock was set


class Indices(NamedTuple):
    """I1 to I5 of section 4.1; the field names are keys of the JSON output."""

    e_M: float  # V  (I2) largest error
    e_F: float  # V  (I3) largest error of the last two seconds
    e_rms: float  # V  (I1)
    u_rms: float  # V  (I4)
    c_u: float  # -  (I5) normalised control variation


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def variation(steps: Any, squares: Any, samples: int) -> Any:
    """c_u (I5) of runs of so many ``samples``: rms of their steps, one fewer than samples, over u_rms.

    ``steps`` [V²]: sum of the squared steps of the voltage, ``squares`` [V²]: of the voltage; c_u is 0 where
    the voltage is 0 throughout.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        u_rms = np.sqrt(squares / samples)
        return np.where(u_rms == 0.0, 0.0, np.sqrt(steps / max(1, samples - 1)) / u_rms)


def indices(
    error: Floats,
    voltage: Floats,
    period: float,
    kept: npt.NDArray[np.bool_] | None = None,
    time: Floats | None = None,
) -> Indices:
    """Compute I1 to I5 of ``error`` [V] and ``voltage`` [V], both sampled every ``period`` [s].

    With ``kept``, of these samples alone: e_F of the last two seconds of them, c_u from the steps between two
    that follow each other. ``time`` [s]: of the samples, where some may be missing; the last two seconds are
    then those of it, and a pause of PAUSE periods is no step. c_u is 0 when the voltage is 0 throughout.
    Raises ValueError for arrays that are empty or unequal.
    """
    steps = np.diff(voltage)
    follow = np.ones(len(steps), dtype=np.bool_) if time is None else np.diff(time) <= PAUSE * period
    recent = round(2.0 / period) + 1
    if kept is not None:
        follow &= kept[1:] & kept[:-1]
        error, voltage = error[kept], voltage[kept]
    elif time is not None:
        recent = int(np.count_nonzero(time >= time[-1:] - 2.0 - 0.5 * period))
    steps = steps[follow]
    if len(error) == 0 or len(error) != len(voltage):
        raise ValueError(
            f"indices need two arrays of one length, not {len(error)} errors and {len(voltage)} voltages"
        )
    last = max(1, min(len(error), recent))
    u_rms = rms(voltage)
    return Indices(
        e_M=float(np.max(np.abs(error))),
        e_F=float(np.max(np.abs(error[-last:]))),
        e_rms=rms(error),
        u_rms=u_rms,
        c_u=(rms(steps) if len(steps) else 0.0) / u_rms if u_rms > 0.0 else 0.0,
    )


def index_row(label: str, values: Sequence[float]) -> str:
    """One line of the table of indices below HEADER."""
    e_m, e_f, e_rms, u_rms, c_u = values
    return f"{label:14}{e_m:10.4f}{e_f:10.4f}{e_rms:11.4f}{u_rms:11.3f}{c_u:9.4f}"
