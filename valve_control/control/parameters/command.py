# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of `command_source`."""

from valve_control.control.laws.common import SAMPLE_PERIOD
from valve_control.control.parameters.valve import FAULT_SAMPLES
from valve_control.parameter import Parameter, Table

MESSAGE = Parameter(
    "message",
    "command",
    "",
    "numbers on spool_command, or points with derivatives on spool_trajectory",
    choices=("command", "trajectory"),
)

COMMAND: Table = (
    SAMPLE_PERIOD,
    Parameter(
        "scenario",
        "point_to_point",
        "",
        "command shape, or array for the numbers in command_file",
        choices=("point_to_point", "sine", "triangle", "step", "sweep", "stepped_sine", "constant", "array"),
    ),
    Parameter("command_file", "", "", "CSV or NPY file with one command per sample period (array)"),
    Parameter(
        "trigger",
        "timer",
        "",
        "trigger of the commands: a timer of the node, spool_position (one command per reading), "
        "valve_voltage (one command per voltage, before the next reading), or lockstep (the first "
        "command at once, then one per reading, none lost)",
        choices=("timer", "spool_position", "valve_voltage", "lockstep"),
        node_only=True,
    ),
    MESSAGE,
    Parameter(
        "listeners", 1, "", "subscriptions to wait for before the command begins", 0, 100, node_only=True
    ),
    Parameter("delay", 0.5, "s", "pause from their arrival to the command", 0.0, 1e6, node_only=True),
    Parameter("duration", 6.0, "s", "duration of the command; afterwards the last command holds", 0.001, 1e6),
    Parameter("amplitude", 2.92, "V", "height, stroke or amplitude", -10.0, 10.0),
    Parameter("offset", 0.0, "V", "added to the command", -10.0, 10.0),
    Parameter("start", 0.25, "s", "standstill before the motion", 0.0, 1e6),
    Parameter("frequency", 6.0, "Hz", "frequency of sine, triangle; first of sweep, stepped sine", 1e-4, 1e4),
    Parameter("end_frequency", 60.0, "Hz", "end of the sweep; last frequency of the stepped sine", 1e-4, 1e4),
    Parameter("sweep_time", 5.0, "s", "duration of the sweep", 1e-3, 1e6),
    Parameter(
        "steps", 30, "", "number of frequencies of the stepped sine, spaced evenly in logarithm", 1, 1000
    ),
    Parameter(
        "cycles", 5, "", "cycles of the triangle; least number at a frequency of the stepped sine", 1, 10000
    ),
    Parameter("step_time", 1.0, "s", "least time of each frequency of the stepped sine", 0.0, 1e4),
    Parameter("max_velocity", 8.0, "V/s", "largest velocity of the point-to-point motion", 1e-3, 1e4),
    Parameter("max_accel", 64.0, "V/s²", "largest acceleration of the point-to-point motion", 1e-3, 1e6),
    Parameter("cycle", 5.81, "s", "period of the point-to-point motion, there and back", 1e-2, 1e6),
    Parameter(
        "fault.command",
        "none",
        "",
        "injected fault of the command",
        choices=("none", "silent", "not_finite", "out_of_range"),
        node_only=True,
    ),
    FAULT_SAMPLES,
)
