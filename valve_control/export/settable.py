# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds the parameters that the C can set while it runs, by building the Params again with other values.

A parameter is settable if it goes into a single number of Params as it is, at both ends of its range and
between; above 0 if 0 turns something off. All others are computed on the way (a discretised filter, a
Riccati equation), depend on each other, or choose a form: they need a new export.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from valve_control.export.unit import Unit, leaves
from valve_control.parameter import Parameter, ParameterError, Value

COMPUTED = "other numbers are computed from it"
DEPENDS = "its range depends on other parameters"
NO_NUMBER = "it is no real number"
FORM = "it chooses what is computed"
LEAST = 1e-9  # lowest value where 0 is a form of its own
WITHOUT = "it has no effect in this export"


class Setter(NamedTuple):
    """A parameter that C can set, or one entry of it."""

    parameter: Parameter
    entry: int | None  # of a list
    path: str  # of the number in Params


class Settable(NamedTuple):
    """Which parameters C can set, and which not, with the reason."""

    setters: list[Setter]
    others: dict[str, str]  # by name; without numbers that have no effect


def find(unit: Unit, done: Callable[[], object] = lambda: None) -> Settable:
    """Parameters of ``unit`` that can be set; ``done`` is called after each that has been tried."""
    setters: list[Setter] = []
    others: dict[str, str] = {}
    base = dict(leaves(unit.params))
    for parameter in unit.table:
        done()
        if parameter.name == "sample_period":
            others[parameter.name] = COMPUTED
            continue
        numbers = list(_numbers(parameter, unit.values[parameter.name]))
        if not numbers:
            others[parameter.name] = NO_NUMBER
        for entry, low, high, now in numbers:
            inner = {high, *_between(low, high, now)}
            reason = _trial(unit, parameter, entry, base, sorted({low, *inner}))
            if reason == FORM and low == 0.0 < now:  # which turns it off; what is on stays so
                positive = parameter._replace(low=LEAST)
                reason = _trial(unit, positive, entry, base, sorted({LEAST, *inner}))
            if isinstance(reason, Setter):
                setters.append(reason)
            elif reason != WITHOUT:
                others[parameter.name] = reason
                break
    setters = [setter for setter in setters if setter.parameter.name not in others]
    taken = [setter.path for setter in setters]
    return Settable([setter for setter in setters if taken.count(setter.path) == 1], others)


def _numbers(parameter: Parameter, value: Value) -> Iterator[tuple[int | None, float, float, float]]:
    """Entry, range and value of each number in ``parameter``."""
    if isinstance(value, float):
        yield None, parameter.low, parameter.high, value
    elif isinstance(value, list) and parameter.length:
        for i, entry in enumerate(value):
            assert isinstance(entry, float)
            yield i, parameter.low, parameter.high, entry


def _between(low: float, high: float, now: float) -> list[float]:
    """Two values inside the range that are not ``now``."""
    return [
        value
        for value in (0.75 * now + 0.25 * low, 0.875 * now + 0.125 * min(high, now + 1.0))
        if value != now
    ]


def _changed(unit: Unit, parameter: Parameter, value: Value) -> dict[str, float]:
    """Numbers of Params with another value of ``parameter``. Raises ParameterError."""
    return dict(leaves(unit.build({**unit.values, parameter.name: value})))


def _trial(
    unit: Unit, parameter: Parameter, entry: int | None, base: dict[str, float], trials: list[float]
) -> Setter | str:
    paths: set[str] = set()
    for value in trials:
        whole: Any = value
        if entry is not None:
            listed = unit.values[parameter.name]
            assert isinstance(listed, list)
            whole = [*listed[:entry], value, *listed[entry + 1 :]]
        try:
            made = _changed(unit, parameter, whole)
        except (ParameterError, ArithmeticError, ValueError):
            return DEPENDS
        if made.keys() != base.keys():
            return FORM
        moved = {path for path, number in made.items() if number != base[path]}
        if any(made[path] != value for path in moved):
            return COMPUTED
        paths |= moved
        if len(paths) > 1:
            return COMPUTED
    return Setter(parameter, entry, paths.pop()) if paths else WITHOUT
