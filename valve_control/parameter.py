# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes one parameter (type, unit, range, meaning), and checks and reads the values of many."""

import math
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, NamedTuple

Value = bool | int | float | str | list[float] | list[str]
Values = dict[str, Value]


class ParameterError(ValueError):
    """Says why a parameter cannot be taken; the message is one sentence for the user."""


class Parameter(NamedTuple):
    """One parameter; its type is that of its default."""

    name: str
    default: Value
    unit: str
    text: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    length: int = 0  # of an array, 0: any
    left_out: tuple[tuple[str, str], ...] = ()  # choices that cannot be taken, and why
    node_only: bool = False  # read by running nodes alone, without effect offline

    @property
    def type_name(self) -> str:
        """Type in words."""
        if isinstance(self.default, bool):
            return "bool"
        if isinstance(self.default, list):
            return f"list of {self._entry[1]}"
        return {int: "integer", float: "double", str: "string"}[type(self.default)]

    @property
    def range_text(self) -> str:
        """Range or choices in words."""
        if self.choices or isinstance(self.default, (str, bool)) or self.type_name == "list of strings":
            return ", ".join(self.choices)
        return f"{self.low:g} to {self.high:g}"

    @property
    def described(self) -> str:
        """Name, default, unit and range in one line, the text below."""
        unit = f" {self.unit}" if self.unit not in ("", "-") else ""
        return f"{self.name} = {self.default}{unit}  ({self.range_text})\n    {self.text}"

    @property
    def _entry(self) -> tuple[type, str]:
        """Type of an array's entries, and its name."""
        assert isinstance(self.default, list)
        return (str, "strings") if isinstance(self.default[0], str) else (float, "doubles")

    def check(self, value: Any) -> Value:
        """Return ``value`` if it has the right type and lies in the range. Raises ParameterError."""
        named = [(self.name, value)]
        if isinstance(self.default, list):
            if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
                raise ParameterError(self._wrong_type(value))
            value = list(value)
            if any(type(v) is not self._entry[0] for v in value):
                raise ParameterError(self._wrong_type(value))
            if self.length and len(value) != self.length:
                raise ParameterError(f"{self.name} has {len(value)} entries; it must have {self.length}")
            named = [(f"{self.name}[{i}]", v) for i, v in enumerate(value)]
        elif type(value) is not type(self.default):
            raise ParameterError(self._wrong_type(value))
        for name, reason in self.left_out:
            if value == name:
                raise ParameterError(f"{self.name} is '{value}'; {reason}")
        if self.choices and value not in self.choices:
            raise ParameterError(f"{self.name} is '{value}'; it must be {one_of(self.choices)}")
        for name, number in named:
            if not isinstance(number, (bool, str)):
                self._check_range(number, name)
        return value  # type: ignore[no-any-return]

    def _wrong_type(self, value: object) -> str:
        form = "1.2, not 1,2" if self.type_name == "double" and isinstance(value, str) else "120.0, not 120"
        quotes = isinstance(self.default, str) and not isinstance(value, list)
        form = "a flat list: plant.num[0][0]" if "[[" in str(value) else form
        article = "an" if self.type_name == "integer" else "a"
        hint = f" (write {form})" if "double" in self.type_name else " (write it in quotes)" if quotes else ""
        return f"{self.name} is {value!r}; it must be {article} {self.type_name}{hint}"

    def _check_range(self, number: float, name: str) -> None:
        if not math.isfinite(number):
            raise ParameterError(f"{name} is {number}; it must be finite")
        if not self.low <= number <= self.high:
            unit = "" if self.unit in ("", "-") else f" {self.unit}"
            raise ParameterError(
                f"{name} is {number:g}{unit}; it must lie between {self.low:g} and {self.high:g}{unit}"
            )


Table = Sequence[Parameter]


def running(*parameters: Parameter) -> Table:
    """Return ``parameters`` marked as those that running nodes alone read."""
    return tuple(parameter._replace(node_only=True) for parameter in parameters)


def one_of(words: Iterable[str]) -> str:
    """``words`` as "a, b or c"."""
    *most, last = [f"'{word}'" for word in words]
    return f"{', '.join(most)} or {last}" if most else last


def defaults(table: Table) -> Values:
    """All parameters of ``table`` at their defaults."""
    return {p.name: p.default for p in table}


def lookup(table: Table, name: str) -> Parameter:
    """Parameter ``name``. Raises ParameterError with the nearest names if there is none."""
    for parameter in table:
        if parameter.name == name:
            return parameter
    raise ParameterError(missing(table, [name]))


def missing(table: Table, names: Iterable[str]) -> str:
    """One sentence: there are no parameters ``names``; did you mean the nearest ones."""
    known = [p.name for p in table]
    near = {n: [k for k in known if k.endswith(f".{n}")][:2] or get_close_matches(n, known, 2) for n in names}
    meant = {name: f"did you mean {one_of(words)}?" if words else "" for name, words in near.items()}
    if len(meant) == 1:
        return "; ".join(["there is no parameter " + one_of(meant), *filter(None, meant.values())])
    listed = [f"'{name}'" + (f" ({hint})" if hint else "") for name, hint in meant.items()]
    return f"there are no parameters {', '.join(listed)}"


def updated(table: Table, values: Mapping[str, Value], changes: Mapping[str, Any]) -> Values:
    """A copy of ``values`` with ``changes``, each of them checked. Raises ParameterError."""
    result = dict(values)
    for name, value in changes.items():
        result[name] = lookup(table, name).check(value)
    return result


def number(values: Values, name: str) -> float:
    """Value of a parameter that the table declares a number."""
    value = values[name]
    assert isinstance(value, (int, float))
    return value


def numbers(values: Values, name: str) -> Sequence[float]:
    """Value of a parameter that the table declares a list of doubles."""
    return [float(entry) for entry in items(values, name)]


def items(values: Values, name: str) -> Sequence[float | str]:
    """Value of a parameter that the table declares a list."""
    value = values[name]
    assert isinstance(value, list)
    return value


def word(values: Values, name: str) -> str:
    """Value of a parameter that the table declares a string."""
    value = values[name]
    assert isinstance(value, str)
    return value
