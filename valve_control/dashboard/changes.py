# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Remembers changes of parameters so that they can be taken back."""

from collections.abc import Mapping
from typing import NamedTuple

from valve_control.parameter import Value, Values

TOGETHER = 1.0  # s  changes of the same parameters that follow so closely are one: a slider that is drawn
MOST = 500  # changes


class Change(NamedTuple):
    """Parameters that were changed together."""

    time: float  # s
    before: Values
    after: Values
    origin: str  # who changed them, in words

    @property
    def text(self) -> str:
        """In one line, such as `oarc.ks1 100.0 → 150.0`."""
        return ", ".join(f"{name} {self.before[name]} → {self.after[name]}" for name in sorted(self.after))


def joined(last: Change | None, change: Change, asked: float) -> Change | None:
    """``last`` and ``change``, asked for at ``asked`` [s], as one, such as moves of a slider; else None."""
    if (
        last is not None
        and last.origin == change.origin
        and last.after.keys() == change.after.keys()
        and asked - last.time < TOGETHER
    ):
        return Change(change.time, last.before, change.after, change.origin)
    return None


class Changes:
    """Changes of one node, of which the newest can be taken back, and then made again."""

    def __init__(self) -> None:
        self.done: list[Change] = []
        self.undone: list[Change] = []

    def add(self, change: Change, asked: float) -> None:
        """Remember ``change``, asked for at ``asked`` [s]; what was undone before cannot be redone."""
        self.undone.clear()
        whole = joined(self.done[-1] if self.done else None, change, asked)
        if whole is not None:
            self.done.pop()
        if whole is None or whole.before != whole.after:  # not a slider that was drawn back to where it was
            self.done.append(whole or change)
            del self.done[:-MOST]

    def newest(self, act: str) -> Change | None:
        """The change that ``act``, undo or redo, is about; None: there is none."""
        changes = self.done if act == "undo" else self.undone
        return changes[-1] if changes else None

    def acted(self, act: str, change: Change) -> None:
        """Note that ``change`` was undone or redone; nothing if another one has come since."""
        source, target = (self.done, self.undone) if act == "undo" else (self.undone, self.done)
        if self.newest(act) is change:
            target.append(source.pop())


def differing(now: Mapping[str, Value], wanted: Mapping[str, Value]) -> Values:
    """Those of ``wanted`` that are not so ``now``; parameters that are not there now are left out."""
    return {name: value for name, value in wanted.items() if name in now and now[name] != value}
