# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Decides which of several controllers of one valve controls: at most one goes on.

Who has answered readings for less than ``YOUNG`` and hears voltages of somebody else stops, since he would
disturb a valve that is controlled. If two controlled before they saw each other, the one whose publisher has
the larger GID stops: both know both GIDs, so they agree without a message. Who stopped begins again when
nobody else gives voltages. Then the one with the smallest GID is the first. Voltages count, not publishers:
an inactive controller has a publisher too, and that of a killed process stays in the graph for a while.
"""

from typing import NamedTuple

YOUNG = 2.0  # s, which middlewares need to show who else is there
BOTH = 5  # windows in a row with voltages of two after which one stops
QUIET = 3  # windows in a row without voltages after which one begins that does not have the smallest GID
MOST = 2  # voltages of a window by which a count may be wrong at its edges


class State(NamedTuple):
    """Whether a controller stands by, and whether there are voltages of others."""

    stands_by: bool
    row: int  # windows in a row with voltages of others, or while it stands by without


ACTIVE = State(False, 0)


def step(s: State, others: int, active: float, is_first: bool) -> State:
    """State after a window with ``others`` voltages of somebody else, ``active`` [s] after the first answer.

    ``is_first``: whether no publisher of voltages has a smaller GID.
    """
    row = s.row + 1 if (others > MOST) != s.stands_by else 0
    if s.stands_by:
        return ACTIVE if row >= (1 if is_first else QUIET) else State(True, row)
    stops = row > 0 and (active < YOUNG or (row >= BOTH and not is_first))
    return State(stops, 0 if stops else row)
