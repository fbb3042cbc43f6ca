# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What-if replay: simulates the closed loop again from the recorded command, with other parameters."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis.indices import rms
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.simulation import delivery, offline
from valve_control.control.supervision import command_course
from valve_control.parameter import Values, defaults, updated
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.parameters import Node
from valve_control.recordings.recording import Aligned, ValveRecording


class WhatIf(NamedTuple):
    """Recorded and simulated run, sampled at the same times."""

    time: Floats  # s
    recorded: Aligned  # on that grid
    original: Aligned  # as recorded
    run: offline.Run
    distance: float  # V, rms of simulated minus recorded measurement
    left_out: list[str]


def replay(
    valve: ValveRecording, signals: Aligned, controller: Mapping[str, Any], simulator: Mapping[str, Any]
) -> WhatIf:
    """Simulate the recorded command; ``controller`` and ``simulator`` win over the recorded parameters.

    Raises BagError without a command, ParameterError for parameters that do not fit.
    """
    if not np.any(np.isfinite(signals.command)):
        raise BagError(f"{valve.name} has no spool_command, so there is nothing to simulate")
    left_out: list[str] = []
    law = _values(valve.controller, CONTROLLER, controller, "controller", left_out)
    plant = _values(valve.simulator, VALVE, simulator, "valve_simulator", left_out)
    period = float(signals.period)
    for values, given in ((law, controller), (plant, simulator)):
        if "sample_period" not in given:
            values["sample_period"] = round(period, 9)
    grid = _on_grid(signals, float(str(law["sample_period"])))
    run = offline.simulate(law, plant, _motion(valve, signals, grid, law))
    distance = rms(run.measurement - grid.measurement)
    if valve.controller is not None and valve.controller.changes:
        left_out.append(
            f"{len(valve.controller.changes)} recorded change(s) of parameters are not simulated: "
            "the run has the values of the beginning"
        )
    return WhatIf(grid.time, grid, signals, run, distance, left_out)


def _motion(valve: ValveRecording, signals: Aligned, grid: Aligned, values: Values) -> Floats:
    """Command [V] at each sample of ``grid``, as a controller with these ``values`` has it."""
    recorded = valve.recorded["spool_command"]
    together = values["lockstep"] is True or valve.paired or valve.coarse  # no command has a time of its own
    if together or not signals.wall or len(recorded.time) == 0:
        return grid.command
    sent = (recorded.time - signals.stamp[0]) * 1e-9
    sound = np.isfinite(recorded.value)
    p = command_course.design(values)
    return delivery.followed(p, recorded.value[sound], sent[sound], sent[sound], len(grid.command))


def _values(
    node: Node | None, table: Any, given: Mapping[str, Any], kind: str, left_out: list[str]
) -> Values:
    if node is None:
        left_out.append(f"the bag has no parameters of a {kind}; defaults and what was given are used")
        return updated(table, defaults(table), given)
    values, refused = node.table_values(node.initial)
    left_out += refused
    return updated(table, values, given)


def _on_grid(signals: Aligned, period: float) -> Aligned:
    """``signals`` sampled every ``period`` [s]; over a gap the last sample holds."""
    count = round((signals.time[-1] - signals.time[0]) / period) + 1
    finer = max(1.0, signals.period / period)
    if count > 3 * finer * len(signals.time) + 10_000:
        raise BagError(
            f"the readings leave gaps: {len(signals.time)} in {signals.time[-1]:.0f} s; choose a part "
            "without them with --from and --to"
        )
    time = np.arange(count) * period
    index = np.clip(np.searchsorted(signals.time, time + 0.5 * period) - 1, 0, len(signals.time) - 1)
    return signals._replace(
        time=time,
        stamp=signals.stamp[index],
        period=period,
        command=signals.command[index],
        measurement=signals.measurement[index],
        voltage=signals.voltage[index],
    )
