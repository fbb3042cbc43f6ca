# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of all nodes of a valve; command line and reference are made from it."""

from valve_control.control.parameters.command import COMMAND as COMMAND
from valve_control.control.parameters.controller import CONTROLLER as CONTROLLER
from valve_control.control.parameters.valve import VALVE as VALVE
from valve_control.parameter import Parameter, Table, running

MANIFOLD: Table = running(
    Parameter("valves", ["valve_1", "valve_2"], "", "names of the valves; each gets a namespace and a node"),
)

RECORDER: Table = running(
    Parameter("bag", "", "", "folder to write, which must not exist; empty: valve_bag_<date>_<time> here"),
    Parameter(
        "storage",
        "auto",
        "",
        "auto: mcap, or sqlite3 where the Python package mcap is missing",
        choices=("auto", "mcap", "sqlite3"),
    ),
    Parameter(
        "compression", "none", "", "compression of chunks; sqlite3 has none", choices=("none", "zstd", "lz4")
    ),
    Parameter(
        "topics",
        [""],
        "",
        "regular expressions, one of which must match the whole name of a topic; empty: the topics of "
        "all valves and axes, /diagnostics and /clock; /parameter_events is always recorded",
    ),
    Parameter("flush_period", 0.25, "s", "longest part that is lost if the recorder is killed", 0.02, 1.0),
)

DASHBOARD: Table = running(
    Parameter("port", 8080, "", "port of the page on 127.0.0.1; 0: any free port", 0, 65535),
    Parameter("token", "", "", "token in the address of the page that permits changes; empty: a new one"),
    Parameter("folder", "out/dashboard", "", "folder of recordings"),
)

NODES: dict[str, Table] = {
    "controller": CONTROLLER,
    "valve_simulator": VALVE,
    "command_source": COMMAND,
    "manifold": MANIFOLD,
    "recorder": RECORDER,
    "dashboard": DASHBOARD,
}
