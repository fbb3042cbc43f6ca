# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes a plant to the rest of the package: name, parameters, equations and what it is like."""

import inspect
import math
import types
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from valve_control.control.plant import valve
from valve_control.control.plant.models import TransferFunction
from valve_control.parameter import Table, Value, Values, defaults

PACKAGE = "valve_control"
FORMS = {
    "initial": ("params",),
    "read": ("params", "state", "noise"),
    "step": ("params", "state", "voltage"),
}


class Plant(NamedTuple):
    """A simulated valve: where its equations are, its parameters, and how it is varied."""

    name: str  # before the dot of its own parameters, and its value of the parameter `valve`
    text: str  # what it is, in a few words
    # Params with u_max [V] and period [s], State with position x.x0 [V] and velocity x.x1 [V/s] of the spool,
    # initial, read and step
    module: types.ModuleType
    parameters: Table
    build: Callable[[Values], Any]  # Params from the simulator's values; raises ParameterError
    # transfer function from voltage to position for small motions, without dead time, friction and flow
    # force; raises ParameterError
    model: Callable[[Values], TransferFunction]
    # linear valve that a set of Params is like for small motions, with all dead time in its LVDT
    linear: Callable[[Any], valve.Params]
    # changed values of a valve with its gain and its speed multiplied by two factors
    scaled: Callable[[Values, float, float], Mapping[str, Value]]
    # Params with the gain times a factor, so many periods more of dead time, and a share of the friction
    varied: Callable[[Any, float, float, float], Any]
    quiet: Callable[[Any], Any]  # Params without noise
    steady: Callable[[Any], Any]  # Params without drift
    # State that goes on under Params that come after the former ones: former, new, state
    resumed: Callable[[Any, Any, Any], Any]
    # force [V] at rest of a voltage [V], over that of ``linear`` in its own volts; None: the voltage itself
    pull: Callable[[Any, float], float] | None = None
    choices: tuple[str, ...] = ()  # values of the parameter `valve`; (): the name
    compiled: bool = True  # whether a node compiles the step, which is too long for plain Python
    package: str = PACKAGE  # that brings it

    @property
    def title(self) -> str:
        """Name and package, for messages."""
        return f"the plant '{self.name}' of the package {self.package}"

    @property
    def values(self) -> tuple[str, ...]:
        """Values of the parameter `valve` that choose it."""
        return self.choices or (self.name,)


class PlantError(ValueError):
    """Says why a plant cannot be used; the message is one sentence without the plant's name."""


def check(plant: Any) -> Plant:
    """Return ``plant`` if it has the form of a plant. Raises PlantError."""
    if not isinstance(plant, Plant):
        raise PlantError(f"it is {plant!r}; it must be a valve_control.control.plant.plant.Plant")
    if not (plant.name.isidentifier() and plant.name.islower()):
        raise PlantError(f"its name is '{plant.name}'; it must be one word in lower case")
    where = plant.module.__name__
    for part, needed in (("Params", ("u_max", "period")), ("State", ("x",))):
        missing = set(needed) - set(getattr(getattr(plant.module, part, None), "_fields", ()))
        if missing:
            raise PlantError(f"{where}.{part} must be a NamedTuple with {' and '.join(sorted(missing))}")
    for part, wanted in FORMS.items():
        function = getattr(plant.module, part, None)
        if not isinstance(function, types.FunctionType):
            raise PlantError(f"{where} has no function {part}({', '.join(wanted)})")
        if len(inspect.signature(function).parameters) != len(wanted):
            raise PlantError(f"{where}.{part} must take ({', '.join(wanted)})")
    for parameter in plant.parameters:
        if not parameter.name.startswith(f"{plant.name}."):
            raise PlantError(f"its parameter {parameter.name} must begin with '{plant.name}.'")
    return plant


def try_out(plant: Plant, values: Values) -> None:
    """Build ``plant`` from ``values`` and compute one step and its linear form. Raises PlantError."""
    module = plant.module
    try:
        given: Values = {**values, **defaults(plant.parameters), "valve": plant.values[0]}
        params = plant.build(given)
        state = module.initial(params)
        reading = module.read(params, state, 0.5)
        after = module.step(params, state, 0.2)
        like, model = plant.linear(params), plant.model(given)
        position, velocity = after.x.x0, after.x.x1
    except Exception as error:
        raise PlantError(f"its first step fails: {type(error).__name__}: {error}") from error
    for found, number in (("read", reading), ("step", position), ("step", velocity)):
        if type(number) is not float or not math.isfinite(number):
            raise PlantError(f"its {found} gives {number!r}; it must be a finite float")
    for found, value, kind in (
        ("build", params, module.Params),
        ("step", after, module.State),
        ("linear", like, valve.Params),
        ("model", model, TransferFunction),
    ):
        if type(value) is not kind:
            own = type(value)
            raise PlantError(
                f"its {found} gives {own.__module__}.{own.__name__}; it must be "
                f"{kind.__module__}.{kind.__name__}"
            )
