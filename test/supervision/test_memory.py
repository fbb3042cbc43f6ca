"""A supervisor that recalls what another one remembered goes on like that one, bit for bit."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, defaults, updated
from valve_control.supervision.memory import account, recall, remember
from valve_control.supervision.supervisor import Supervisor

LAWS = ["arc", "oarc", "pid", "compensator", "open_loop"]


def made(**changes):
    values = updated(CONTROLLER, defaults(CONTROLLER), {k.replace("__", "."): v for k, v in changes.items()})
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    return supervisor


def drive(supervisor, moves):
    voltages = []
    for number, (what, value) in moves:
        if what == "command":
            supervisor.command(value)
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
@settings(max_examples=30, deadline=None)
@given(moves=MOVES, cut=st.integers(1, 19), gap=st.integers(0, 30))
def test_goes_on_bit_for_bit(law, moves, cut, gap):
    """Whatever happened before: commands, faults, takeovers, homing, gaps."""
    numbered = [(i + (gap if i > 10 else 0), move) for i, move in enumerate(moves, start=1)]
    first, second = made(controller=law), made(controller=law)
    drive(first, numbered[:cut])
    assert recall(second, remember(first))
    assert remember(second) == remember(first)
    assert np.array_equal(drive(first, numbered[cut:]), drive(second, numbered[cut:]), equal_nan=True)


@pytest.mark.parametrize("text", ["", "{}", "[1, 2]", '{"law": "arc"}', "null", '"arc"'])
def test_what_is_no_memory_changes_nothing(text):
    supervisor = made()
    before = remember(supervisor)
    assert not recall(supervisor, text)
    assert remember(supervisor) == before


def test_the_memory_of_another_law_or_version_is_refused():
    other = made(controller="oarc")
    drive(other, [(i, ("sample", 0.01)) for i in range(1, 30)])
    supervisor = made()
    assert not recall(supervisor, remember(other))
    changed = json.loads(remember(other)) | {"law": "arc"}
    changed["_state"] = ["arc", [1.0]]
    assert not recall(supervisor, json.dumps(changed))


@pytest.mark.parametrize(
    "text", ["", "{}", "[1, 2]", '{"run": 1, "row": "7", "values": {}}', '{"row": 7}', "null"]
)
def test_an_account_says_its_row_its_parameters_and_the_command(text):
    supervisor = made(arc__k1=70.0)
    supervisor.command(1.25)
    told = account(remember(supervisor, 5, 7))
    assert (told.run, told.row, told.command) == (5, 7, 1.25)
    assert told.values == updated(CONTROLLER, defaults(CONTROLLER), {"arc.k1": 70.0})
    assert account(text) is None
