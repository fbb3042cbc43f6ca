# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Takes command and parameters from a recorded run, for a simulation of this run."""

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import delivery
from valve_control.control.supervision import command_course
from valve_control.parameter import Values, defaults, number, updated
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.recording import Aligned, ValveRecording


def parameters_of(valve: ValveRecording, signals: Aligned, notes: list[str]) -> dict[str, Values]:
    """Parameters by node at the beginning of the run, defaults for those that are not recorded.

    All nodes have the sample period of the ``signals``. ``notes``: what is not recorded, or not used. Raises
    ParameterError.
    """
    found = {"command_source": defaults(NODES["command_source"])}
    for kind, node in (("controller", valve.controller), ("valve_simulator", valve.simulator)):
        if node is None:
            found[kind] = defaults(NODES[kind])
            notes.append(f"the recording has no parameters of a {kind}: defaults count below yours")
        else:
            found[kind], refused = node.table_values(node.initial)
            notes += refused
    if valve.controller is not None and valve.controller.changes:
        notes.append(
            f"{len(valve.controller.changes)} recorded change(s) of parameters are not simulated: "
            "the run has the values of the beginning"
        )
    period = {"sample_period": round(signals.period, 9)}
    return {kind: updated(NODES[kind], values, period) for kind, values in found.items()}


def command_of(valve: ValveRecording, signals: Aligned, values: Values) -> Floats:
    """Recorded command [V] at each sample, as a controller with these ``values`` has it.

    Over a gap the last one holds. Raises BagError without a command, ParameterError for too many samples.
    """
    if not np.any(np.isfinite(signals.command)):
        raise BagError(f"{valve.name} has no spool_command, so there is nothing to simulate")
    period = number(values, "sample_period")
    count = round((signals.time[-1] - signals.time[0]) / period) + 1
    if count > 3 * len(signals.time) + 10_000:
        raise BagError(f"the readings of {valve.name} leave gaps; choose a part with --from and --to")
    build.check_memory(count)
    recorded = valve.signals["spool_command"]
    # In lockstep, and where stamps do not tell it, no command has a time of its own.
    if values["lockstep"] is True or valve.paired or valve.coarse or not signals.wall:
        time = np.arange(count) * period
        index = np.clip(np.searchsorted(signals.time, time + 0.5 * period) - 1, 0, len(signals.time) - 1)
        return signals.command[index]
    sent = (recorded.time - signals.stamp[0]) * 1e-9
    return delivery.followed(command_course.design(values), recorded.value, sent, sent, count)
