# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds saturation and limit cycles in a finished run, with the detector that the controller node uses."""

from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.compiling import compile_function
from valve_control.control.supervision import oscillation


class LimitCycle(NamedTuple):
    """The longest oscillation of the voltage that the command does not explain."""

    frequency: float  # Hz
    amplitude: float  # V
    start: float  # s
    end: float  # s


def survey(p: oscillation.Params, voltages: Floats, command: Floats, longest: Floats) -> None:
    """Step through each row of ``voltages`` (N×n) [V].

    A row of ``longest`` (N×4) receives frequency [Hz], amplitude [V], start and end [s].
    """
    for i in range(voltages.shape[0]):
        s, row = oscillation.NOTHING, longest[i]
        for k in range(voltages.shape[1]):
            before = s.cycles
            s = oscillation.step(p, s, k * p.period, voltages[i, k], command[k])
            lasts = s.maximum_time - s.since >= row[3] - row[2]
            if s.cycles != before and lasts and oscillation.sustained(s):
                row[0], row[1] = oscillation.frequency(s), oscillation.amplitude(s)
                row[2], row[3] = s.since, s.maximum_time


def surveyed(
    voltages: Floats, command: Floats, period: float, amplitude: float, compiled: bool = True
) -> Floats:
    """``longest`` of ``survey`` for cycles of at least ``amplitude`` [V]; 0.0 where there are none."""
    longest = np.zeros((len(voltages), 4))
    if amplitude > 0.0 and len(voltages):
        step = compile_function(survey, nogil=True) if compiled else survey
        rows = np.ascontiguousarray(voltages), np.ascontiguousarray(command)
        step(oscillation.Params(amplitude, period), *rows, longest)
    return longest


def limit_cycle(
    voltage: Floats, command: Floats, period: float, amplitude: float, compiled: bool = True
) -> LimitCycle | None:
    """The limit cycle of at least ``amplitude`` [V] in ``voltage`` [V] under ``command`` [V], or None."""
    (longest,) = surveyed(voltage[None], command, period, amplitude, compiled).tolist()
    return LimitCycle(*longest) if longest[0] > 0.0 else None


def in_words(saturated: float, cycle: LimitCycle | None) -> str:
    """Saturation (share of the samples) and limit cycle of a run in one line, "" if there is neither."""
    parts = []
    if saturated > 0.0:
        parts.append(f"saturated in {100.0 * saturated:.2g} % of the samples")
    if cycle is not None:
        parts.append(
            f"limit cycle at {cycle.frequency:.3g} Hz with {cycle.amplitude:.2g} V "
            f"from {cycle.start:.3g} to {cycle.end:.3g} s"
        )
    return ", ".join(parts)


def as_dict(saturated: float, cycle: LimitCycle | None) -> dict[str, Any]:
    """Saturation and limit cycle of a run for JSON."""
    return {"saturated": saturated, "limit_cycle": None if cycle is None else cycle._asdict()}
