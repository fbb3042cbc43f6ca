# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Saves and loads the signals of one run, so that nodes can record what a later process draws."""

import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control import outputs
from valve_control.control.simulation.offline import Run

Array = npt.NDArray[np.float64]


class Trace(NamedTuple):
    """Signals of one run."""

    source: str  # nodes or offline
    period: float  # s
    command: Array  # V
    measurement: Array  # V
    voltage: Array  # V
    filled: int  # messages not heard, taken from the equal run offline

    @property
    def time(self) -> Array:
        """Time [s] of each sample."""
        return np.arange(len(self.command), dtype=np.float64) * self.period


def offline(run: Run) -> Trace:
    """Trace of an offline run."""
    return Trace("offline", run.period, run.command, run.measurement, run.voltage, 0)


def heard(run: Run, measurement: Array, voltage: Array) -> Trace:
    """Trace of the nodes' messages, NaN where none was received; ``run``: the same run offline."""
    missing = int(np.count_nonzero(np.isnan(measurement)) + np.count_nonzero(np.isnan(voltage)))
    return offline(run)._replace(
        source="nodes",
        measurement=np.where(np.isnan(measurement), run.measurement, measurement),
        voltage=np.where(np.isnan(voltage), run.voltage, voltage),
        filled=missing,
    )


def save(path: Path, trace: Trace) -> None:
    """Write ``trace`` as NPZ. Raises OSError."""
    fields: dict[str, Any] = trace._asdict()
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **fields)
    outputs.write(str(path), stream.getvalue())


def load(path: Path) -> Trace:
    """The trace that ``save`` wrote. Raises OSError."""
    with np.load(path, allow_pickle=False) as stored:
        entries = {name: stored[name] for name in Trace._fields}
    return Trace(
        **{
            **entries,
            "source": str(entries["source"]),
            "period": float(entries["period"]),
            "filled": int(entries["filled"]),
        }
    )
