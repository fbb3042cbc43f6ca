# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists all plants by name: those of this package, and those of other packages that are installed.

Another package adds a plant by an entry point of the group ``valve_control.plants`` that names a ``Plant``.
"""

from typing import Any

from valve_control.control import compiling, plugins
from valve_control.control.plant import linear_valve, solenoid_valve, transfer_functions, valve
from valve_control.control.plant.common import PARAMETERS
from valve_control.control.plant.plant import Plant, try_out
from valve_control.parameter import Values, defaults, word

GROUP = "valve_control.plants"
TRIED: Values = {
    "sample_period": 0.001,
    "u_max": 10.0,
    "seed": 1,
    **defaults(transfer_functions.custom_parameters("")),
    **defaults(PARAMETERS),
}


def accepted(found: object, taken: dict[str, Plant]) -> Plant:
    """``found`` if it is a plant that works and whose names are free. Raises PluginError."""
    plant = plugins.check(found, Plant)
    for other in taken.values():
        if other.name == plant.name or set(other.values) & set(plant.values):
            raise plugins.PluginError(f"the name is taken by a plant of {other.package}")
        if other.module.Params is plant.module.Params:
            raise plugins.PluginError(
                f"its Params are those of the plant '{other.name}'; it must have its own"
            )
    try_out(plant, TRIED)
    compiling.add_sources(plant.module)
    return plant


PLANTS = {plant.name: plant for plant in (linear_valve.PLANT, solenoid_valve.PLANT)}
LEFT_OUT = plugins.add(GROUP, "plant", accepted, PLANTS)  # why, as a sentence
CHOICES = {value: plant for plant in PLANTS.values() for value in plant.values}  # of the parameter `valve`
_OF_PARAMS = {plant.module.Params: plant for plant in PLANTS.values()}


def chosen(values: Values) -> Plant:
    """The plant that the parameter `valve` names."""
    return CHOICES[word(values, "valve")]


def plant_of(params: Any) -> Plant:
    """The plant whose Params ``params`` are. Raises KeyError."""
    return _OF_PARAMS[type(params)]


def linear(params: Any) -> valve.Params:
    """The linear valve that the plant with ``params`` is like for small motions."""
    return plant_of(params).linear(params)
