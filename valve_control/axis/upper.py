# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Names the upper levels of an axis, each a module with the same functions.

``step`` (params, state, goal, reading) returns the spool command [V], the next state and the terms, of which
``error`` [m] and ``spool`` [V] are in all. ``initial`` (params) is the state before, AT_REST the terms.
``missed`` (params, state) is the state after a sample without a reading.
``motion`` is the spool's motion at a sample, ``estimates`` (state) what was learnt of the axis. A level that
NEEDS_PRESSURES cannot do without them.
"""

import types

from valve_control.axis import axis_arc_sampled, axis_pid

LEVELS: dict[str, types.ModuleType] = {"axis_pid": axis_pid, axis_arc_sampled.NAME: axis_arc_sampled}
