"""Everything that a supervisor remembers, as text: a shadow replay can begin with it in the middle of a run.

JSON writes floats with the digits that give the same bits again.
"""

import json
import typing
from typing import Any, NamedTuple

from valve_control.laws import velocity
from valve_control.parameters.table import Values
from valve_control.simulation.closed_loop import LAWS
from valve_control.supervision import fade
from valve_control.supervision.supervisor import Homing, Supervisor

PLAIN = (
    "voltage", "samples", "conditions", "_expiry", "_blocked", "_now", "_sequence", "_measurement",
    "_start_position", "_bridged", "_sound", "_saturated_for", "_command", "_command_time", "_gone_since",
    "_used", "_renewed", "_effective", "_taking_over", "_kept",
)  # fmt: skip
RECORDS: dict[str, Any] = {
    "_homing": Homing, "_offset": fade.State, "_command_offset": fade.State, "_velocity": velocity.State,
}  # fmt: skip
STATES = ("_state", "_former")  # of the law, each with the law's name


class Account(NamedTuple):
    """What a controller said of itself."""

    run: int  # its journal
    row: int  # the next one
    values: Values  # its parameters
    command: float | None  # V, in force
    text: str  # everything


def remember(supervisor: Supervisor, run: int = 0, row: int = 0) -> str:
    """What ``supervisor`` remembers before ``row`` of the journal ``run``, and its parameters, as JSON."""
    memory: dict[str, Any] = {"run": run, "row": row, "values": dict(sorted(supervisor.values.items()))}
    memory |= {name: getattr(supervisor, name) for name in (*PLAIN, *RECORDS)}
    memory["law"] = supervisor.name
    memory["monitor"] = supervisor.monitor_memory()
    for name in STATES:
        state = getattr(supervisor, name)
        memory[name] = None if state is None else [_law_of(state), state]
    return json.dumps(memory)


def account(text: str) -> Account | None:
    """``text`` as an account, None if it is none."""
    try:
        memory = json.loads(text)
        told = Account(memory["run"], memory["row"], memory["values"], memory["_command"], text)
    except (ValueError, KeyError, TypeError):
        return None
    sound = isinstance(told.run, int) and isinstance(told.row, int) and isinstance(told.values, dict)
    return told if sound and isinstance(told.command, (float, type(None))) else None


def recall(supervisor: Supervisor, text: str) -> bool:
    """Bring ``supervisor``, which has the parameters of that moment, to where ``text`` was written.

    False, and nothing done, if the text is of another law or of another version of this package.
    """
    try:
        memory = json.loads(text)
        if memory["law"] != supervisor.name:
            return False
        found = {name: memory[name] for name in PLAIN}
        law, estimates = found["_kept"]
        found["_kept"] = (law, None if estimates is None else tuple(estimates))
        for name, kind in RECORDS.items():
            found[name] = None if memory[name] is None else _built(kind, memory[name])
        for name in STATES:
            entry = memory[name]
            found[name] = None if entry is None else _built(LAWS[entry[0]].State, entry[1])
        watched = dict(memory["monitor"])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        return False
    for name, value in found.items():
        setattr(supervisor, name, value)
    supervisor.recall_monitor(watched)
    return True


def _law_of(state: Any) -> str:
    return next(name for name, law in LAWS.items() if isinstance(state, law.State))


def _built(kind: Any, values: Any) -> Any:
    """A named tuple of ``kind`` from nested lists."""
    hints = typing.get_type_hints(kind)
    if len(hints) != len(values):
        raise ValueError
    return kind(
        *(
            _built(hint, value) if hasattr(hint, "_fields") else value
            for hint, value in zip(hints.values(), values, strict=True)
        )
    )
