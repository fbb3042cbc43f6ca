# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of all nodes, those of the axis included."""

from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.control.parameters.drivers import VALVE_DRIVER
from valve_control.control.parameters.table import NODES
from valve_control.parameter import Table

ROS_NODES: dict[str, Table] = {**NODES, **AXIS_NODES, "valve_driver": VALVE_DRIVER}
