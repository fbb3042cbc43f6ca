# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Adds to a registry the entries that other installed packages bring by entry points, and checks them.

A law, a plant and a driver are each a NamedTuple with name, parameters and package.
"""

import math
from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from typing import Any, TypeVar

import numpy as np

from valve_control.control.compiling import in_words

PACKAGE = "valve_control"

T = TypeVar("T")


class PluginError(ValueError):
    """Says why an entry cannot be used; the message is one sentence without its name."""


def add(
    group: str, kind: str, accepted: Callable[[Any, dict[str, T]], T], known: dict[str, T]
) -> dict[str, str]:
    """Add to ``known`` what the entry points of ``group`` name; returns why others are left out, by name.

    ``kind``: what an entry is, in one word; ``accepted``: returns what was imported if it can be added to
    those that are known, and raises PluginError if not.
    """
    left_out: dict[str, str] = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        package = point.dist.name if point.dist is not None else point.module
        try:
            entry: Any = accepted(point.load(), known)
        except Exception as error:  # its import, and its first step, may raise any
            reason = str(error) if isinstance(error, PluginError) else in_words(error)
            left_out[point.name] = f"the {kind} '{point.name}' of the package {package} is left out: {reason}"
        else:
            known[entry.name] = entry._replace(package=package)
    return left_out


def check(entry: Any, kind: type[T]) -> T:
    """``entry`` if it is a ``kind`` whose name is a word that its parameters begin with, else PluginError."""
    if not isinstance(entry, kind):
        raise PluginError(f"it is {entry!r}; it must be a {kind.__module__}.{kind.__name__}")
    description: Any = entry
    name = description.name
    if not (name.isidentifier() and name.islower()):
        raise PluginError(f"its name is '{name}'; it must be one word in lower case")
    for parameter in description.parameters:
        if not parameter.name.startswith(f"{name}."):
            raise PluginError(f"its parameter {parameter.name} must begin with '{name}.'")
    return entry


def check_results(results: Iterable[tuple[str, Any, type]]) -> None:
    """Raise PluginError unless each of the ``results`` of named functions has its type; a float is finite."""
    for name, value, wanted in results:
        sound = isinstance(value, wanted)  # np.float64 is a float
        if not sound or (wanted is float and not math.isfinite(value)):
            kind = "finite float such as 0.0" if wanted is float else f"{wanted.__module__}.{wanted.__name__}"
            raise PluginError(f"its {name} gives {value!r}; it must be a {kind}")
        for field, part in getattr(value, "_asdict", dict)().items():
            if isinstance(part, (list, np.ndarray)):
                text = f"its {name} gives an array for {wanted.__name__}.{field}"
                raise PluginError(f"{text}; it must be a float, such as float(gains[0, 0])")
