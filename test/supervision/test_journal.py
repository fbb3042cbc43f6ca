# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Rows of the journal, and a supervisor that recalls what another one remembered."""

import json

import changed
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.laws import registry
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.journal import COLUMNS, HEAD, Event, Journal, block
from valve_control.control.supervision.state_snapshot import account, restore, snapshot
from valve_control.parameter import defaults, updated


@pytest.fixture
def journal():
    """A journal whose clock goes on by 1 µs a row, after the start of its ``supervisor``."""
    times = iter(range(1_790_000_000_000_000_000, 1_790_000_001_000_000_000, 1000))
    journal = Journal(lambda: next(times))
    journal.supervisor = changed.supervisor(journal.note)
    journal.supervisor.start()
    journal.take()
    return journal


def events(journal):
    """Kinds of the rows that wait; they are taken."""
    rows = journal.take()
    return [Event(int(event)) for event in block(rows).rows[:, 1]] if rows else []


def test_what_is_said_twice_is_one_row(journal):
    for count in (1, 2, 2, 3, 1, 0):
        journal.supervisor.publishers("spool_command", count)
    rows = block(journal.take()).rows
    assert [Event(int(row[1])) for row in rows] == 3 * [Event.COMMAND_PUBLISHERS]
    assert list(rows[:, COLUMNS.index("number")]) == [2.0, 3.0, 0.0]
    journal.supervisor.sample(0.0, 1, 0.001)
    journal.supervisor.command_gone()
    journal.supervisor.command_gone()
    assert events(journal) == [Event.READING, Event.COMMAND_GONE]
    journal.supervisor.trajectory_gone()
    assert events(journal) == [], "there was no trajectory"
    journal.supervisor.trajectory(Motion(0.1, 0.0, 0.0))
    journal.supervisor.trajectory_gone()
    journal.supervisor.trajectory_gone()
    assert events(journal) == [Event.TRAJECTORY, Event.TRAJECTORY_GONE]


def test_silence_before_the_first_reading_has_no_voltage(journal):
    assert journal.supervisor.silence(0.1) == 0.0
    journal.supervisor.sample(0.0, 1, 0.001)
    assert journal.supervisor.silence(0.1) == 0.0
    rows = block(journal.take()).rows
    assert list(np.isnan(rows[:, COLUMNS.index("voltage")])) == [True, False, False]


def test_readings_that_a_standstill_made_stale_are_not_lost(journal):
    """Reading 1 is answered; 2 and 3 overflowed the queue, 4 to 8 were skipped, 10 is lost."""
    journal.supervisor.sample(0.0, 1, 0.001)
    for number in range(4, 9):
        journal.supervisor.skip(0.0, number, 0.001)
    for number in (9, 11, 12):
        journal.supervisor.sample(0.0, number, 0.001)
    assert journal.supervisor.memory.counts["lvdt_lost"] == 3


def test_blocks_follow_one_another_and_tell_a_gap(journal):
    blocks = []
    for number in range(1, 4):
        journal.supervisor.command(0.1 * number)
        journal.supervisor.sample(0.0, number, 0.001)
        blocks.append(block(journal.take()))
    assert [len(one.rows) for one in blocks] == [1, 1, 1], "a command stands in the row of its reading"
    assert blocks[1].follows(blocks[0]) and blocks[2].follows(blocks[1])
    assert not blocks[2].follows(blocks[0]) and not blocks[0].follows(None)
    assert np.all(np.diff([one.time[0] for one in blocks]) > 0)


def broken(name, value, event=None):
    """What a journal gives, with ``value`` in column ``name`` of its only row, of kind ``event``."""

    def change(numbers):
        numbers[HEAD + COLUMNS.index(name)] = value
        if event is not None:
            numbers[HEAD + 1] = event
        return numbers

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [(lambda numbers: numbers[:HEAD], "no rows"),
     (lambda numbers: np.concatenate(([np.nan], numbers[1:])), "no rows"),
     (broken("event", len(Event)), "rows of another"),
     (broken("elapsed", np.nan), "rows of another"),
     (broken("number", np.nan, Event.LVDT_PUBLISHERS), "rows of another"),
     (broken("command", np.nan, Event.TRAJECTORY_REFUSED), "rows of another")],
)  # fmt: skip
def test_other_numbers_are_no_rows(journal, change, said):
    journal.supervisor.command(1.0)
    journal.supervisor.sample(0.0, 1, 0.001)
    rows = np.array(journal.take())
    assert len(block(rows).rows) == 1
    with pytest.raises(ValueError, match=f"{said} .*journal"):
        block(change(rows))


LAWS = tuple(registry.LAWS)
SETTINGS = {"reshaping__lead": 0.006, "reshaping__lead_accel": 1.0}


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
    first, second = (changed.supervisor(controller=law, **SETTINGS) for _ in range(2))
    drive(first, numbered[:cut])
    assert restore(second, snapshot(first))
    assert snapshot(second) == snapshot(first)
    assert np.array_equal(drive(first, numbered[cut:]), drive(second, numbered[cut:]), equal_nan=True)


def test_the_memory_of_another_law_or_version_is_refused():
    other = changed.supervisor(controller="oarc")
    drive(other, [(i, ("sample", 0.01)) for i in range(1, 30)])
    supervisor = changed.supervisor()
    assert not restore(supervisor, snapshot(other))
    former = json.loads(snapshot(other)) | {"law": "arc"}
    former["state"]["law"] = ["arc", [1.0]]
    assert not restore(supervisor, json.dumps(former))


@pytest.mark.parametrize(
    "text", ["", "{}", "[1, 2]", '{"run": 1, "row": "7", "values": {}}', '{"row": 7}', "null"]
)
def test_an_account_says_its_row_its_parameters_and_the_command(text):
    supervisor = changed.supervisor(arc__k1=70.0)
    supervisor.command(1.25)
    told = account(snapshot(supervisor, 5, 7))
    assert (told.run, told.row, told.command) == (5, 7, 1.25)
    assert told.values == updated(CONTROLLER, defaults(CONTROLLER), {"arc.k1": 70.0})
    assert account(text) is None
