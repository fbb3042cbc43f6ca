# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What is handed over: a law, alone or under the watch, or a plant, with its parameters."""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

from valve_control.control.laws import linearisation
from valve_control.control.laws.common import COMMON
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.reshaping import PARAMETERS as RESHAPING
from valve_control.control.laws.signals import Start
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import registry
from valve_control.control.supervision import binding
from valve_control.control.supervision.memory import Memory
from valve_control.export import kinds
from valve_control.export.kinds import Kind, identifier
from valve_control.parameter import Table, Values, number, word

SUPERVISION = (
    "command_limit",
    "command_timeout",
    "command.bridge",
    "command.lag",
    "neutral_rate",
    "neutral_accel",
    "transfer_time",
    "oscillation_limit",
    "reshaping.lead",
    "reshaping.lead_accel",
)
NODES = ("lvdt.period_limit",)  # of nodes alone: in C the period is that of the machine's own timer


class Unit(NamedTuple):
    """A law or a plant that is exported."""

    name: str
    text: str  # what it is
    is_law: bool
    module: Any  # Params, State and the steps
    params: Any
    table: Table  # parameters that it may be built from
    values: Values
    build: Callable[[Values], Any]  # Params from values; raises ParameterError
    inner: Any = None  # the Unit of the law that is under the watch; None: a law alone, or a plant

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return number(self.values, "sample_period")

    def begin(self) -> Any:
        """State in which a law or a plant begins at rest."""
        rest = (Start(0.0, 0.0, 0.0, 0.0, 0.0),) if self.is_law else ()
        return self.module.initial(self.params, *rest)


def law(values: Values) -> Unit:
    """The law that ``controller`` of the controller's ``values`` names. Raises ParameterError."""
    if not linearisation.is_on(values):
        return _alone(values)
    made = _alone(values)
    module = linearisation.exported(made.module)

    def built(values: Values) -> Any:
        on: Values = {**values, "linearisation.enabled": True}
        return module.Params(*linearisation.behind(on, made.build(on)))

    table = (*made.table, *linearisation.PARAMETERS)
    text = f"{made.text}, with the inverse of the valve's static curve behind it"
    return made._replace(text=text, module=module, params=built(values), table=table, build=built)


def _alone(values: Values) -> Unit:
    """The law without a curve behind it. Raises ParameterError."""
    found = LAWS[word(values, "controller")]
    table = (*found.parameters, *COMMON, *RESHAPING)
    return Unit(found.name, found.text, True, found.module, found.build(values), table, values, found.build)


def supervised(values: Values) -> Unit:
    """The law that ``controller`` of the controller's ``values`` names, under supervision.

    Raises ParameterError.
    """
    inner = _alone(values)
    on = linearisation.is_on(values)
    module = binding.bound(LAWS[inner.name], linearisation.inverse(values) if on else 0.0)

    def built(values: Values) -> Any:
        return module.design(values, inner.build(values))

    own = tuple(
        p for p in CONTROLLER if p.name in SUPERVISION or (p.name.startswith("lvdt.") and p.name not in NODES)
    )
    curve = linearisation.PARAMETERS if on else ()
    table = (*inner.table, *(p for p in own if p not in inner.table), *curve)
    text = f"{inner.text}, under the watch over LVDT and command"
    return Unit(
        name=inner.name,
        text=text,
        is_law=True,
        module=module,
        params=built(values),
        table=table,
        values=values,
        build=built,
        inner=inner,
    )


def plant(values: Values) -> Unit:
    """The valve with the simulator's ``values``. Raises ParameterError."""
    kind = registry.chosen(values)
    return Unit("valve", kind.text, False, kind.module, kind.build(values), VALVE, values, kind.build)


def in_c(module: Any, memory: Memory) -> Any:
    """``memory`` as C has it: of ``module``, which is bound to one law; numbers that are NaN are 0 there."""
    values = (getattr(memory, name) for name in module.State._fields)
    return module.State(*(0.0 if isinstance(v, float) and math.isnan(v) else v for v in values))


def begun(module: Any) -> Any:
    """What C remembers after switching on."""
    return in_c(module, Memory())


@cache
def _listed(record: Any) -> dict[str, Kind]:
    return kinds.fields(record)


@cache
def _is_plain(record: Any) -> bool:
    return all(kind.what == "real" for kind in _listed(record).values())


def leaves(record: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Numbers of a nested NamedTuple with the way to them in C, such as theta.a1; no arrays, no indices."""
    listed: dict[str, Kind] = _listed(type(record))  # type: ignore[arg-type]
    for (name, kind), value in zip(listed.items(), record, strict=True):
        here = f"{path}{identifier(name)}" + (".value" if kind.what == "optional" else "")
        if hasattr(value, "_fields"):
            yield from leaves(value, f"{here}.")
        elif isinstance(value, float):
            yield here, value


def places(kind: Kind, path: str) -> list[str]:
    """Expressions in C of all numbers in what stands at ``path``, as doubles; those of ``numbers``."""
    if kind.what == "record":
        return [
            place
            for name, inner in _listed(kind.record).items()
            for place in places(inner, f"{path}.{identifier(name)}")
        ]
    if kind.what == "optional":
        return [f"(double){path}.given", *places(kind.items[0], f"{path}.value")]
    return [path if kind.what == "real" else f"(double){path}"]


def numbers(kind: Kind, value: Any, words: Mapping[str, int]) -> list[float]:
    """All numbers in ``value``, each for one of ``places``; what is not given counts as 0.

    ``words``: number of each word in C.
    """
    if kind.what == "record":
        if value is not None and _is_plain(kind.record):
            return list(value)
        parts = value if value is not None else [None] * len(_listed(kind.record))
        return [
            number
            for inner, part in zip(_listed(kind.record).values(), parts, strict=True)
            for number in numbers(inner, part, words)
        ]
    if kind.what == "optional":
        return [float(value is not None), *numbers(kind.items[0], value, words)]
    if value is None:
        return [0.0]
    return [float(words[value] if kind.what == "word" else value)]
