# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads numbers as people type them, and puts parameters on sliders."""

import math
import re
from typing import NamedTuple

from valve_control.parameter import Value

STEPS = 1000  # places of a slider
DECADES = 2.0  # from which on a range that does not touch 0 gets a logarithmic slider
FAR = 1000.0  # end from which on a range that begins at 0 gets one too ...
LEAST = 1e-9  # ... which begins at this share of its end
NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")


class EntryError(ValueError):
    """Says why a text is no value; the message is one sentence for the user."""


class Field(NamedTuple):
    """A parameter as its node describes it."""

    name: str
    kind: str  # bool, integer, double, string, doubles, strings
    text: str = ""  # with its unit in brackets at the end, as the nodes of this package say it
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False

    @property
    def bounded(self) -> bool:
        """Whether it is a number with a finite range."""
        return self.kind in ("integer", "double") and math.isfinite(self.low) and math.isfinite(self.high)

    @property
    def range_text(self) -> str:
        """Range in words, "" if it has none."""
        return f"{self.low:g} to {self.high:g}" if self.bounded else ""


def number(text: str) -> float:
    """Number with a decimal point or comma. Raises EntryError.

    A text with both, or with two of them, is refused: 1,234.5 is a thousand in one country, an error in
    another.
    """
    word = text.strip().replace("\N{MINUS SIGN}", "-")
    if not NUMBER.fullmatch(word):
        hint = "; write it without separators of thousands" if re.fullmatch(r"[+-]?[\d.,' ]+", word) else ""
        raise EntryError(f"'{text.strip()}' is no number{hint}" if word else "a number is missing")
    value = float(word.replace(",", "."))
    if not math.isfinite(value):
        raise EntryError(f"{word} is too large")
    return value


def parse(field: Field, text: str) -> Value:
    """Value of ``field`` from what was typed. Raises EntryError."""
    word = text.strip()
    if field.kind == "string":
        return word
    if field.kind == "bool":
        if word.lower() not in ("true", "false"):
            raise EntryError(f"'{word}' is neither true nor false")
        return word.lower() == "true"
    if field.kind == "strings":
        return [part.strip() for part in re.split(r"[;,]", word)]
    if field.kind == "doubles":
        # Without brackets a comma may be a decimal one, if no space follows.
        between = r"[;,\s]+" if word.startswith("[") else r"\s*;\s*|,?\s+"
        return [number(part) for part in re.split(between, word.strip("[]").strip()) if part]
    value = number(word)
    if field.bounded and not field.low <= value <= field.high:
        raise EntryError(f"{value:g} is out of range: {field.range_text}")
    if field.kind == "integer":
        if value != int(value):
            raise EntryError(f"{value:g} is no whole number")
        return int(value)
    return value


def shown(value: Value) -> str:
    """Text of ``value`` from which ``parse`` makes the same value again."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return "; ".join(str(entry) for entry in value)
    return str(value)


class Scale(NamedTuple):
    """The places 0 to STEPS of a slider over a range of values.

    A logarithmic one begins at ``floor``; where the range begins at 0, place 0 is 0 all the same.
    """

    low: float
    high: float
    floor: float = 0.0  # above 0: logarithmic from here on

    @property
    def logarithmic(self) -> bool:
        """Whether equal ways are equal ratios."""
        return self.floor > 0.0

    def place(self, value: float) -> int:
        """Nearest place of ``value``."""
        value = min(max(value, self.low), self.high)
        if not self.logarithmic:
            share = (value - self.low) / (self.high - self.low)
        elif value < self.floor:
            share = 0.0
        else:
            share = math.log(value / self.floor) / math.log(self.high / self.floor)
        return round(share * STEPS)

    def value(self, place: float) -> float:
        """Value at ``place``, rounded to what the slider can tell apart, and inside the range."""
        share = min(max(place / STEPS, 0.0), 1.0)
        if share == 0.0:
            return self.low
        if self.logarithmic:
            value, digits = self.floor * (self.high / self.floor) ** share, 4
        else:
            value, digits = self.low + share * (self.high - self.low), 6
        return min(max(float(f"{value:.{digits}g}"), self.low), self.high)


def slid(field: Field, scale: Scale, place: float) -> float:
    """Value of ``field`` where its slider stands at ``place``."""
    value = scale.value(place)
    return round(value) if field.kind == "integer" else value


def scale(field: Field) -> Scale | None:
    """Scale of a slider for ``field``, logarithmic where its range spans decades; None if it has no range."""
    if not field.bounded or field.low >= field.high:
        return None
    if field.low > 0.0 and math.log10(field.high / field.low) >= DECADES:
        return Scale(field.low, field.high, field.low)
    if field.low == 0.0 and field.high >= FAR:
        return Scale(0.0, field.high, 1.0 if field.kind == "integer" else field.high * LEAST)
    return Scale(field.low, field.high)
