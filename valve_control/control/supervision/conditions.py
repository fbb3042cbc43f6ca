# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps the reported conditions: what is wrong now, a sentence each; an event stays reported for a second."""

from typing import NamedTuple

LATCH = 1.0  # s for which a passing event stays reported


class State(NamedTuple):
    """The reported sentences and events; both dictionaries are replaced, never changed in place."""

    texts: dict[str, str]  # sentence by name, in the order in which they came
    expiry: dict[str, float]  # s, by name, until when a passing event stays reported


NOTHING = State({}, {})


def report(s: State, name: str, text: str) -> State:
    """State ``s`` with ``text`` under ``name``, unless something is reported under that name already."""
    return s if name in s.texts else State({**s.texts, name: text}, s.expiry)


def clear(s: State, name: str) -> State:
    """State ``s`` without ``name``."""
    if name not in s.texts:
        return s
    texts = {key: text for key, text in s.texts.items() if key != name}
    return State(texts, {key: end for key, end in s.expiry.items() if key != name})


def latch(s: State, name: str, text: str, now: float, lasting: float = LATCH) -> State:
    """State ``s`` with an event at ``now`` [s], which stays reported for ``lasting`` [s]."""
    return State(report(s, name, text).texts, {**s.expiry, name: now + lasting})


def step(s: State, now: float) -> State:
    """State ``s`` without the events that are over at ``now`` [s]."""
    for name, end in s.expiry.items():
        if now > end:
            s = clear(s, name)
    return s
