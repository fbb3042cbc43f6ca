# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Takes a test of a valve out of a bag: its voltages and readings, sample by sample."""

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.control.analysis.timing import leaps, numbered_by_time, true_period
from valve_control.control.laws.registry import LAWS
from valve_control.design.identification.experiment import Experiment
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.clocks import in_order
from valve_control.recordings.recording import Aligned, Recording, ValveRecording, align, voltages_before

MOSTLY = 0.5  # share of the readings that a voltage answers, of a controller that answers each


def _kept_period(aligned: Aligned, sequence: Integers, notes: list[str]) -> float:
    """Time [s] between two readings, as told unless the readings show another one."""
    count, period = len(aligned.time), aligned.period
    measured = true_period(aligned.stamp, sequence) if aligned.wall else np.nan
    if not np.isfinite(measured):
        measured = (aligned.time[-1] - aligned.time[0]) / max(1, count - 1) if count > 1 else period
    if 0.98 * period < measured < 1.02 * period:
        return period
    notes.append(f"the readings came every {1e3 * measured:.4g} ms, not every {1e3 * period:.4g} ms as told")
    return float(measured)


def _numbered(aligned: Aligned, sequence: Integers, period: float, notes: list[str]) -> Integers:
    """Numbers of the readings from 0 on, with gaps where some were lost."""
    count = len(aligned.time)
    if in_order(sequence) and sequence[-1] - sequence[0] < 2 * count:
        return np.asarray(sequence - sequence[0])
    if count <= 1:
        return np.arange(count)
    notes.append("the readings have no numbers, so lost ones are told by time alone")
    return numbered_by_time(aligned.stamp, period) if aligned.wall else np.arange(count)


def _samples(
    aligned: Aligned, valve: ValveRecording, index: Integers, period: float
) -> tuple[Floats, Floats, Floats]:
    """Voltage, position and command [V] by the number of the sample; NaN where they are not known.

    Voltages that were lost are left out: of readings that have no answer while most of them have one.
    """
    length = int(index[-1]) + 1
    voltage, position, command, time = (np.full(length, np.nan) for _ in range(4))
    voltage[index], position[index], time[index] = aligned.voltage, aligned.measurement, aligned.time
    command[index] = aligned.command
    if aligned.answered is not None and np.mean(aligned.answered) > MOSTLY:
        voltage[index[~aligned.answered]] = np.nan
    lost = np.isnan(time)
    time = np.interp(np.arange(length), index, aligned.time)
    if aligned.answered is not None and aligned.wall and np.any(lost):
        stamp = aligned.stamp[0] + np.round((time[lost] + period) * 1e9).astype(np.int64)
        voltage[lost] = voltages_before(valve, stamp)
    return voltage, position, command


def recorded(recording: Recording, valve: ValveRecording) -> Experiment:
    """Voltages and readings of a recorded test of ``valve``. Raises BagError."""
    for part in ("spool_position", "valve_voltage"):
        if part not in valve.signals or len(valve.signals[part].time) == 0:
            raise BagError(
                f"{valve.name} has no {part}, which identification needs; --map says what plays its part"
            )
    aligned = align(valve)
    notes = [f"times are {recording.clock.name}", *recording.problems, *valve.doubts]
    count = len(aligned.time)
    sequence = valve.signals["spool_position"].sequence[-count:]
    period = _kept_period(aligned, sequence, notes)
    index = _numbered(aligned, sequence, period, notes)
    voltage, position, command = _samples(aligned, valve, index, period)
    length = len(voltage)
    if length > count:
        notes.append(f"{length - count} of {length} readings were lost and are left out")
    cuts = index[leaps(aligned.stamp, index, period)] if aligned.wall and count > 1 else index[:0]
    if len(cuts):
        notes.append(
            f"time leaps {len(cuts)} times beside the readings, because the clock was set or readings are "
            "missing"
        )
    initial = {} if valve.controller is None else valve.controller.initial
    law = str(initial.get("controller", "open_loop"))
    feedback = law if law in LAWS and LAWS[law].feedback else ""
    return Experiment(
        source=f"{recording.bag.path.name}: {valve.name}",
        period=period,
        voltage=voltage,
        position=position,
        segments=(),
        u_max=float(initial.get("u_max", 10.0)),
        notes=tuple(notes),
        feedback=feedback,
        command=command,
        leaps=tuple(cuts.tolist()),
    )
