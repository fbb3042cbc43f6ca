# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes a plant to the rest of the package: name, parameters, equations and what it is like."""

import types
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from valve_control.control import plugins
from valve_control.control.plant import valve
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.parameter import Table, Value, Values, defaults


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
    package: str = plugins.PACKAGE  # that brings it

    @property
    def title(self) -> str:
        """Name and package, for messages."""
        return f"the plant '{self.name}' of the package {self.package}"

    @property
    def values(self) -> tuple[str, ...]:
        """Values of the parameter `valve` that choose it."""
        return self.choices or (self.name,)


def try_out(plant: Plant, values: Values) -> None:
    """Build ``plant``, compute one step and its linear form. Raises PluginError, or what ``plant`` raises."""
    module = plant.module
    given: Values = {**values, **defaults(plant.parameters), "valve": plant.values[0]}
    params = plant.build(given)
    state = module.initial(params)
    reading = module.read(params, state, 0.5)
    after = module.step(params, state, 0.2)
    like, model = plant.linear(params), plant.model(given)
    numbers = [("read", reading), ("step", after.x.x0), ("step", after.x.x1)]
    numbers += [("build", params.u_max), ("build", params.period)]
    plugins.check_results(
        [
            *((name, value, float) for name, value in numbers),
            ("build", params, module.Params),
            ("step", after, module.State),
            ("linear", like, valve.Params),
            ("model", model, TransferFunction),
        ]
    )
