# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A supervisor that recalls what another one remembered goes on like that one, bit for bit."""

import json

import changed
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.laws import registry
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.supervision.state_snapshot import account, restore, snapshot
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated

LAWS = tuple(registry.LAWS)
SETTINGS = {
    "reshaping__lead": 0.006,
    "reshaping__lead_accel": 1.0,
}


def made(**changes):
    values = changed.controller(**changes)
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    return supervisor


def drive(supervisor, moves):
    voltages = []
    for number, (what, value) in moves:
        if what == "command":
            supervisor.command(value, 1.0 + 0.004 * number, 0.0004)
        elif what == "silence":
            voltages.append(supervisor.silence(0.03))
        elif what == "gone":
            supervisor.command_gone()
        elif what == "reset":
            supervisor.reset()
        else:
            voltages.append(supervisor.sample(np.nan if what == "nan" else value, number, 0.001))
    return voltages


MOVES = st.lists(
    st.one_of(
        st.tuples(st.just("sample"), st.floats(-0.05, 0.05)),
        st.tuples(st.just("command"), st.floats(-3.0, 3.0)),
        st.tuples(st.sampled_from(["silence", "gone", "reset", "nan"]), st.just(0.0)),
    ),
    min_size=20,
    max_size=120,
)


@pytest.mark.parametrize("law", LAWS)
@settings(max_examples=15, deadline=None)
@given(moves=MOVES, cut=st.integers(1, 19), gap=st.integers(0, 30))
def test_goes_on_bit_for_bit(law, moves, cut, gap):
    """Whatever happened before: commands, faults, takeovers, homing, gaps."""
    numbered = [(i + (gap if i > 10 else 0), move) for i, move in enumerate(moves, start=1)]
    first, second = made(controller=law, **SETTINGS), made(controller=law, **SETTINGS)
    drive(first, numbered[:cut])
    assert restore(second, snapshot(first))
    assert snapshot(second) == snapshot(first)
    assert np.array_equal(drive(first, numbered[cut:]), drive(second, numbered[cut:]), equal_nan=True)


def test_the_memory_of_another_law_or_version_is_refused():
    other = made(controller="oarc")
    drive(other, [(i, ("sample", 0.01)) for i in range(1, 30)])
    supervisor = made()
    assert not restore(supervisor, snapshot(other))
    changed = json.loads(snapshot(other)) | {"law": "arc"}
    changed["state"]["law"] = ["arc", [1.0]]
    assert not restore(supervisor, json.dumps(changed))


@pytest.mark.parametrize(
    "text", ["", "{}", "[1, 2]", '{"run": 1, "row": "7", "values": {}}', '{"row": 7}', "null"]
)
def test_an_account_says_its_row_its_parameters_and_the_command(text):
    supervisor = made(arc__k1=70.0)
    supervisor.command(1.25)
    told = account(snapshot(supervisor, 5, 7))
    assert (told.run, told.row, told.command) == (5, 7, 1.25)
    assert told.values == updated(CONTROLLER, defaults(CONTROLLER), {"arc.k1": 70.0})
    assert account(text) is None
