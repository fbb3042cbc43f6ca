"""Writes all that a supervisor remembers as JSON, and restores it, so that a replay can begin in mid-run.

JSON writes floats with the digits that give the same bits again. The text has the fields of the supervisor's
``State`` by name, and what is in them as nested lists.
"""

import json
import types
import typing
from collections.abc import Iterable
from typing import Any, NamedTuple

from valve_control.laws import command_lead
from valve_control.laws.registry import LAWS
from valve_control.parameter import Values, defaults
from valve_control.parameters.table import CONTROLLER
from valve_control.supervision.record import State
from valve_control.supervision.supervisor import Supervisor

# Fields of the record that older snapshots do not have, where nothing was there.
LATER = {"course": None, "trajectory": None, "lead": None}
LAW_STATES = ("law", "former")  # of the record: states of a law, each with the law's name


class Account(NamedTuple):
    """A parsed snapshot that a controller published."""

    run: int  # its journal
    row: int  # the next one
    values: Values  # its parameters
    command: float | None  # V, in force
    text: str  # everything


def snapshot(supervisor: Supervisor, run: int = 0, row: int = 0) -> str:
    """State of ``supervisor`` before ``row`` of the journal ``run``, with its parameters, as JSON."""
    state = supervisor.state._asdict()
    for name in LAW_STATES:
        state[name] = None if state[name] is None else [_law_of(state[name]), state[name]]
    values = dict(sorted(supervisor.values.items()))
    return json.dumps({"run": run, "row": row, "values": values, "law": supervisor.name, "state": state})


def account(text: str) -> Account | None:
    """Parse ``text`` as a snapshot; None if it is none."""
    try:
        told = json.loads(text)
        present = _present(told)
        if present is not told:
            told, text = present, json.dumps(present)
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
        state = _present(told)["state"]
        hints = typing.get_type_hints(State)
        found = {name: _built(hints[name], state[name]) for name in State._fields}
        for name in LAW_STATES:
            entry = state[name]
            found[name] = None if entry is None else _built(LAWS[entry[0]].module.State, entry[1])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        return False
    supervisor.state = State(**found)
    return True


def _law_of(state: Any) -> str:
    return next(name for name, law in LAWS.items() if isinstance(state, law.module.State))


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


def _present(told: dict[str, Any]) -> dict[str, Any]:
    """A snapshot as this version writes it: ``told`` itself, or with what has come since it was written."""
    if "state" not in told:
        told = _of_version_0_1(told)
    state, values = told["state"], told["values"]
    if state.keys() >= LATER.keys() and values.keys() >= defaults(CONTROLLER).keys():
        return told
    state = LATER | state
    if state["lead"] is not None:
        later = len(command_lead.State._fields) - len(state["lead"])
        state = state | {"lead": [*state["lead"], *[0.0] * later]}
    state = {name: state[name] for name in (*(n for n in State._fields if n in state), *state)}
    return told | {"values": dict(sorted((defaults(CONTROLLER) | values).items())), "state": state}


def _of_version_0_1(told: dict[str, Any]) -> dict[str, Any]:
    """Turn a snapshot of version 0.1, the supervisor's attributes side by side, into one of today."""

    def taken(names: Iterable[str], source: dict[str, Any] = told) -> list[Any]:
        return [source[name] for name in names]

    monitor = told["monitor"]
    judged = (
        "_last", "_age", "_raw", "_jumped", "_equal", "_lowest", "_highest", "_frozen_at", "_course", "_rate",
        "_surprise", "_offset",
    )  # fmt: skip
    evidence = told["_evidence"]
    state = {
        "samples": told["samples"],
        "now": told["_now"],
        "voltage": told["voltage"],
        "sequence": told["_sequence"],
        "judged": taken(judged, monitor),
        "pace": told["_rate"],
        "trust": taken(("_bridged", "_sound", "_blocked", "_doubt")),
        "measurement": told["_measurement"],
        "velocity": told["_velocity"],
        "evidence": None if evidence is None else [*evidence[:3], evidence[3:]],
        "command": taken(
            ("_command", "_command_time", "_renewed", "_gone_since", "_homing", "_start_position")
        ),
        "used": told["_used"],
        "effective": told["_effective"],
        "transfer": taken(("_offset", "_command_offset", "_taking_over")),
        "law": told["_state"],
        "former": told["_former"],
        "kept": told["_kept"],
        "saturated_for": told["_saturated_for"],
        "cycle": told["_oscillation"],
        "said": taken(("conditions", "_expiry")),
    }
    return {name: told[name] for name in ("run", "row", "values", "law")} | {"state": state}
