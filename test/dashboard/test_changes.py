# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Undo and redo; what a node's own word about its parameters means."""

from hypothesis import given
from hypothesis import strategies as st

from valve_control.dashboard.changes import Change, Changes, differing
from valve_control.dashboard.valve import NodeState
from valve_control.parameter import Parameter

NAMES = ("a", "b", "c")


def node(**values):
    state = NodeState("/controller")
    state.answered({name: Parameter(name, 1.0, "", "") for name in values}, values)
    return state


@given(
    st.lists(
        st.one_of(
            st.dictionaries(st.sampled_from(NAMES), st.integers(0, 5), min_size=1),
            st.sampled_from(["undo", "redo"]),
        ),
        max_size=40,
    )
)  # fmt: skip
def test_undo_and_redo_lead_through_all_states(acts):
    changes, values = Changes(), dict.fromkeys(NAMES, 0)
    past, future = [dict(values)], []
    for k, act in enumerate(acts):
        if act == "undo":
            values.update(changes.back())
            if changes.done:
                changes.went_back()
                future.append(past.pop())
        elif act == "redo":
            values.update(changes.forth())
            if changes.undone:
                changes.went_forth()
                past.append(future.pop())
        elif after := differing(values, act):
            changes.add(Change(10.0 * k, {n: values[n] for n in after}, after, "here"), 10.0 * k)
            values.update(after)
            past.append(dict(values))
            future.clear()
        assert values == past[-1]


def test_a_slider_that_is_drawn_is_one_change():
    changes = Changes()

    def add(time, before, after, asked=None):
        changes.add(Change(time, before, after, "here"), time if asked is None else asked)

    for k in range(20):
        add(0.1 * k, {"k1": float(k)}, {"k1": k + 1.0})
    assert len(changes.done) == 1 and changes.back() == {"k1": 0.0}
    # A node that takes long to answer tears no gesture apart: the pause counts, not the wait.
    add(5.0, {"k1": 20.0}, {"k1": 21.0}, asked=2.0)
    assert len(changes.done) == 1 and changes.back() == {"k1": 0.0}
    add(6.5, {"k2": 1.0}, {"k2": 2.0})
    add(9.0, {"k2": 2.0}, {"k2": 3.0})
    assert [change.after for change in changes.done] == [{"k1": 21.0}, {"k2": 2.0}, {"k2": 3.0}]
    add(9.5, {"k2": 3.0}, {"k2": 2.0})  # and back: undo has nothing to take back
    assert len(changes.done) == 2
