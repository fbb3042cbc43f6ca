"""What is handed over: a law, or the plant, with the parameters that it was built from."""

import types
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from valve_control.export.kinds import identifier
from valve_control.laws.common import COMMON
from valve_control.laws.registry import LAWS
from valve_control.laws.reshaping import PARAMETERS as RESHAPING
from valve_control.parameter import Table, Values, number, word
from valve_control.parameters import build
from valve_control.parameters.table import VALVE
from valve_control.plant import valve

PLANTS = ("valve",)


class Unit(NamedTuple):
    """A law or a plant that is exported."""

    name: str
    text: str  # what it is
    is_law: bool
    module: types.ModuleType  # Params, State and the steps
    params: Any
    table: Table  # parameters that it may be built from
    values: Values
    build: Callable[[Values], Any]  # Params from values; raises ParameterError

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return number(self.values, "sample_period")


def law(values: Values) -> Unit:
    """The law that ``controller`` of the controller's ``values`` names. Raises ParameterError."""
    found = LAWS[word(values, "controller")]
    table = (*found.parameters, *COMMON, *RESHAPING)
    return Unit(found.name, found.text, True, found.module, found.build(values), table, values, found.build)


def plant(name: str, values: Values) -> Unit:
    """The plant ``name`` of PLANTS with the simulator's ``values``. Raises ParameterError."""
    text = "proportional directional control valve with friction, flow force, amplifier and LVDT"
    return Unit(name, text, False, valve, build.valve_params(values), VALVE, values, build.valve_params)


def leaves(record: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Numbers of a nested NamedTuple with the way to them in C, such as theta.a1; no arrays, no indices."""
    for name, value in zip(record._fields, record, strict=True):
        here = f"{path}{identifier(name)}"
        if hasattr(value, "_fields"):
            yield from leaves(value, f"{here}.")
        elif isinstance(value, float):
            yield here, value
