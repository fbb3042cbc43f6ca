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


def survey(p: oscillation.Params, voltage: Floats, command: Floats, longest: Floats) -> None:
    """Step through all samples; ``longest`` receives frequency [Hz], amplitude [V], start and end [s]."""
    s = oscillation.NOTHING
    for k in range(voltage.shape[0]):
        before = s.cycles
        s = oscillation.step(p, s, k * p.period, voltage[k], command[k])
        if (
            s.cycles != before
            and oscillation.sustained(s)
            and s.maximum_time - s.since >= longest[3] - longest[2]
        ):
            longest[0] = oscillation.frequency(s)
            longest[1] = oscillation.amplitude(s)
            longest[2] = s.since
            longest[3] = s.maximum_time


def limit_cycle(
    voltage: Floats, command: Floats, period: float, amplitude: float, compiled: bool = True
) -> LimitCycle | None:
    """The limit cycle of at least ``amplitude`` [V] in ``voltage`` [V] under ``command`` [V], or None."""
    longest = np.zeros(4)
    if amplitude > 0.0:
        step = compile_function(survey) if compiled else survey
        rows = np.ascontiguousarray(voltage), np.ascontiguousarray(command)
        step(oscillation.Params(amplitude, period), *rows, longest)
    return LimitCycle(*map(float, longest)) if longest[0] > 0.0 else None


def survey_all(p: oscillation.Params, voltages: Floats, command: Floats, longest: Floats) -> None:
    """``survey`` of each row of ``voltages`` (N×n), whose ``longest`` is a row of that (N×4)."""
    for i in range(voltages.shape[0]):
        survey(p, voltages[i], command, longest[i])


def ends_at_rest(voltages: Floats, period: float, amplitude: float) -> Floats:
    """Times [s] at which the limit cycles in N ``voltages`` [V] (N×n) end, at a command of 0 V; 0.0: none.

    They are those that ``limit_cycle`` finds, of at least ``amplitude`` [V].
    """
    longest = np.zeros((len(voltages), 4))
    if amplitude > 0.0 and len(voltages):
        p = oscillation.Params(amplitude, period)
        rows = np.ascontiguousarray(voltages)
        compile_function(survey_all, nogil=True)(p, rows, np.zeros(rows.shape[1]), longest)
    return np.where(longest[:, 0] > 0.0, longest[:, 3], 0.0)


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
