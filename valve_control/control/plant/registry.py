# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists all plants by name: those of this package, and those of other packages that are installed.

Another package adds a plant by an entry point of the group ``valve_control.plants`` that names a ``Plant``.
"""

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from valve_control.control import compiling
from valve_control.control.plant import linear_valve, models, solenoid_valve, valve
from valve_control.control.plant.common import PARAMETERS
from valve_control.control.plant.plant import Plant, PlantError, check, try_out
from valve_control.parameter import Values, defaults, word

GROUP = "valve_control.plants"
TRIED: Values = {
    "sample_period": 0.001,
    "u_max": 10.0,
    "seed": 1,
    **defaults(models.custom_parameters("")),
    **defaults(PARAMETERS),
}


def _plugged_in(point: EntryPoint, taken: dict[str, Plant]) -> Plant:
    """The plant of ``point``. Raises PlantError."""
    try:
        found = point.load()
    except Exception as error:
        raise PlantError(f"it cannot be imported: {type(error).__name__}: {error}") from error
    plant = check(found)
    for other in taken.values():
        if other.name == plant.name or set(other.values) & set(plant.values):
            raise PlantError(f"the name is taken by a plant of {other.package}")
        if other.module.Params is plant.module.Params:
            raise PlantError(f"its Params are those of the plant '{other.name}'; it must have its own")
    try_out(plant, TRIED)
    source = getattr(plant.module, "__file__", None)
    if source is not None:
        compiling.add_sources(plant.module.__name__.split(".")[0], Path(source).parent)
    return plant._replace(package=point.dist.name if point.dist is not None else point.module)


def _all() -> tuple[dict[str, Plant], dict[str, str]]:
    plants = {plant.name: plant for plant in (linear_valve.PLANT, solenoid_valve.PLANT)}
    refused: dict[str, str] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        package = point.dist.name if point.dist is not None else point.module
        try:
            plant = _plugged_in(point, plants)
        except PlantError as error:
            refused[point.name] = f"the plant '{point.name}' of the package {package} is left out: {error}"
        else:
            plants[plant.name] = plant
    return plants, refused


PLANTS, LEFT_OUT = _all()  # LEFT_OUT: why, as a sentence
REFUSED = list(LEFT_OUT.values())
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
