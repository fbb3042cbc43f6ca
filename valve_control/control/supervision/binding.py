# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Binds control_step.py to one law: its functions stand in the places, its records in Params and Memory."""

import collections
import types
from collections.abc import Callable, Collection, Mapping
from typing import Any, get_type_hints

from valve_control.control.compiling import bind
from valve_control.control.laws.law import Law
from valve_control.control.laws.projection import Theta
from valve_control.control.supervision import bumpless_transfer, control_step
from valve_control.control.supervision.memory import Memory
from valve_control.control.supervision.watch_table import REPORTING
from valve_control.parameter import Values

NOT_IN_C = {watch.slot for watch in REPORTING} | {  # of the memory
    *("samples", "sequence", "pace", "kept", "saturated_for", "said", "name", "changed", "counts")
}


def with_places(places: Mapping[str, Any]) -> types.SimpleNamespace:
    """The functions of control_step.py with others in their ``places``."""
    step = control_step.__name__
    own = {n: f for n, f in {**vars(control_step), **places}.items() if getattr(f, "__module__", "") == step}
    functions = {n: f for n, f in own.items() if isinstance(f, types.FunctionType)}
    return types.SimpleNamespace(**bind(functions, places))


def places_of(law: Law, line: Any) -> dict[str, Callable[..., Any]]:
    """The functions of ``law`` by the names of their places; ``line`` as in ``control_step.Params``."""
    module = law.module
    reshapes = "reshaping" in module.Params._fields
    return {
        "law_initial": module.initial,
        "law_step": module.step,
        "law_hold": module.hold,
        "law_steady_command": law.steady_command,
        "law_resumed": bumpless_transfer.resumed,
        "law_commanded": control_step.by_motion if reshapes else control_step.law_commanded,
        "amplified": control_step.amplified if isinstance(line, float) else control_step.linearised,
    }


def bound(law: Law, line: Any) -> types.SimpleNamespace:
    """Params, State and the functions of control_step.py for ``law`` alone, as they are exported to C.

    ``line`` as in ``control_step.Params``.
    """
    module = law.module
    hints = get_type_hints(module.Params)
    adapts = law.adapts and {"theta_initial", "theta_min", "theta_max"} <= hints.keys()
    params = _record(control_step.Params, {"law": module.Params, "line": type(line)}, ("watches",))
    state = module.State | None
    memory = _record(Memory, {"law": state, "former": state, "proven": state}, NOT_IN_C)
    memory.__name__, memory.changes = "State", True
    others = {
        "Params": params,
        "State": memory,
        "Theta": hints["theta_initial"] if adapts else Theta,
        "law_resumed": control_step.with_estimates if adapts else control_step.law_resumed,
        "watch_block": control_step.no_watches,
    }
    namespace = with_places({**places_of(law, line), **others})
    kinds = {control_step.Params: params, Memory: memory, Any | None: state}
    for function in vars(namespace).values():
        is_step = getattr(function, "__module__", "") == control_step.__name__
        if is_step and isinstance(function, types.FunctionType):
            annotations = function.__annotations__
            annotations.update({argument: kinds.get(kind, kind) for argument, kind in annotations.items()})

    def designed(values: Values, law: Any, answered: bool = True) -> Any:
        whole = control_step.design(values, law, answered)
        return params(*(getattr(whole, name) for name in params._fields))

    namespace.design = designed
    return namespace


def _record(template: Any, kinds: dict[str, Any], without: Collection[str] = ()) -> Any:
    """A NamedTuple with the fields of ``template``, other types of some, and ``without`` others."""
    hints = {n: h for n, h in {**get_type_hints(template), **kinds}.items() if n not in without}
    record: Any = collections.namedtuple(template.__name__, list(hints))  # type: ignore[misc]
    record.__annotations__, record.__doc__ = hints, template.__doc__
    comments = getattr(template, "template", template)  # of the fields
    setattr(record, "template", comments)  # noqa: B010
    return record
