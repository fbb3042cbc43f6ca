# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes all that a supervisor remembers as JSON, and restores it, so that a replay can begin in mid-run.

JSON writes floats with the digits that give the same bits again. The text has the fields of the supervisor's
``Memory`` by name, and what is in them as nested lists.
"""

import json
import types
import typing
from typing import Any, NamedTuple

from valve_control.control.laws.registry import LAWS
from valve_control.control.supervision.memory import KEPT, NEVER, Memory
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import Values

LAW_STATES = ("law", "former", "proven")  # of the memory: states of a law, each with the law's name


class Account(NamedTuple):
    """A parsed snapshot that a controller published."""

    run: int  # its journal
    row: int  # the next one
    values: Values  # its parameters
    command: float | None  # V, in force
    text: str  # everything


def snapshot(supervisor: Supervisor, run: int = 0, row: int = 0) -> str:
    """State of ``supervisor`` before ``row`` of the journal ``run``, with its parameters, as JSON."""
    state = {name: getattr(supervisor.memory, name) for name in KEPT}
    for name in LAW_STATES:
        if state[name] is not None:
            owner = next(law for law in LAWS.values() if isinstance(state[name], law.module.State))
            state[name] = [owner.name, state[name]]
    values = dict(sorted(supervisor.values.items()))
    return json.dumps({"run": run, "row": row, "values": values, "law": supervisor.name, "state": state})


def account(text: str) -> Account | None:
    """Parse ``text`` as a snapshot; None if it is none."""
    try:
        told = json.loads(text)
        found = Account(told["run"], told["row"], told["values"], told["state"]["command"][0], text)
    except (ValueError, KeyError, TypeError, IndexError):
        return None
    sound = isinstance(found.run, int) and isinstance(found.row, int) and isinstance(found.values, dict)
    return found if sound and isinstance(found.command, (float, type(None))) else None


def restore(supervisor: Supervisor, text: str) -> bool:
    """Set ``supervisor``, which already has the snapshot's parameters, to the state in ``text``.

    False, and nothing done, if the text is of another law or of another version of this package.
    """
    try:
        told = json.loads(text)
        if told["law"] != supervisor.name:
            return False
        state, before = told["state"], supervisor.memory
        hints = typing.get_type_hints(Memory)
        found = {name: _built(hints[name], state[name]) for name in KEPT if name not in LAW_STATES}
        for name in LAW_STATES:
            entry = state[name]
            found[name] = None if entry is None else _built(LAWS[entry[0]].module.State, entry[1])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        return False
    jumped = found["said"].expiry.get("lvdt_jump_bridged", NEVER)
    supervisor.memory = Memory(
        **found, jumped_until=jumped, name=before.name, changed=before.changed, counts=before.counts
    )
    return True


def _built(kind: Any, value: Any) -> Any:
    """Turn ``value`` from JSON into a ``kind``: records and tuples are lists there."""
    if isinstance(kind, types.UnionType):
        return None if value is None else _built(typing.get_args(kind)[0], value)
    if hasattr(kind, "_fields"):
        hints = typing.get_type_hints(kind).values()
        return kind(*(_built(hint, entry) for hint, entry in zip(hints, value, strict=True)))
    if typing.get_origin(kind) is tuple:
        entries = typing.get_args(kind)
        each = [entries[0]] * len(value) if entries[-1] is ... else entries
        return tuple(_built(hint, entry) for hint, entry in zip(each, value, strict=True))
    return value
