# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Remembers changes of parameters so that they can be taken back, and two sets to compare."""

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

    def add(self, change: Change, asked: float | None = None) -> None:
        """Remember ``change``, asked for at ``asked`` [s]; what was undone before cannot be redone."""
        self.undone.clear()
        whole = joined(self.done[-1] if self.done else None, change, change.time if asked is None else asked)
        if whole is not None and whole.before == whole.after:
            self.done.pop()  # a slider that was drawn back to where it was
        elif whole is not None:
            self.done[-1] = whole
        else:
            self.done.append(change)
            del self.done[:-MOST]

    def back(self) -> Values:
        """Values that take back the newest change, {} if there is none."""
        return dict(self.done[-1].before) if self.done else {}

    def forth(self) -> Values:
        """Values that make the change again that was taken back last, {} if there is none."""
        return dict(self.undone[-1].after) if self.undone else {}

    def went_back(self) -> None:
        """Note that the values of ``back`` are in force."""
        self.undone.append(self.done.pop())

    def went_forth(self) -> None:
        """Note that the values of ``forth`` are in force."""
        self.done.append(self.undone.pop())

    def forget(self) -> None:
        """Forget all: the node was started anew."""
        self.done.clear()
        self.undone.clear()


def differing(now: Mapping[str, Value], wanted: Mapping[str, Value]) -> Values:
    """Those of ``wanted`` that are not so ``now``; parameters that are not there now are left out."""
    return {name: value for name, value in wanted.items() if name in now and now[name] != value}


class Comparison:
    """Two sets of parameters, A and B, between which one goes to and fro."""

    def __init__(self) -> None:
        self.sets: dict[str, Values] = {}
        self.active = ""  # the one that was kept or set last

    def keep(self, which: str, values: Mapping[str, Value]) -> None:
        """Keep ``values`` as set ``which``, A or B."""
        self.sets[which] = dict(values)
        self.active = which

    def other(self) -> str:
        """The set that the key goes to, "" while there are not two."""
        if len(self.sets) < 2:
            return ""
        return "B" if self.active == "A" else "A"
