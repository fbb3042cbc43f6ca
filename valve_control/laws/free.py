"""Describes the numbers of a law that a tuner may choose: which, within what range, on what scale."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from valve_control.parameter import Value, Values, number, numbers

DIGITS = 4  # that are chosen, so that a file holds just what was tried


class Free(NamedTuple):
    """One number that may be chosen."""

    name: str  # of a parameter, or name[i] for the entry i of a list
    low: float
    high: float
    logarithmic: bool = True  # scale: of the number's logarithm, or of the number itself
    followers: tuple[tuple[str, float], ...] = ()  # numbers that are always this one times a factor
    only: tuple[str, ...] = ()  # a parameter, and its values for which this number matters; (): always

    def from_share(self, share: float) -> float:
        """The number at ``share``, 0 to 1, of the range."""
        share = min(1.0, max(0.0, share))
        if self.logarithmic:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        return float(f"{value:.{DIGITS}g}")

    def to_share(self, value: float) -> float:
        """Where ``value`` lies in the range, 0 to 1; outside: the nearer end."""
        value = min(self.high, max(self.low, value))
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def matters(self, values: Values) -> bool:
        """Whether the number matters with these ``values`` of the controller."""
        return not self.only or values[self.only[0]] in self.only[1:]


def present(free: Free, values: Values) -> float:
    """The number in ``values``."""
    name, index = _split(free.name)
    return number(values, name) if index is None else float(numbers(values, name)[index])


def placed(chosen: Sequence[tuple[Free, float]], values: Values) -> dict[str, Value]:
    """The parameters that change in ``values`` when each of the ``chosen`` numbers is put in its place."""
    made: dict[str, Value] = {}
    for free, value in chosen:
        followers = [(name, float(f"{value * factor:.{DIGITS}g}")) for name, factor in free.followers]
        for name, entry in [(free.name, value), *followers]:
            whole, index = _split(name)
            if index is None:
                made[whole] = entry
                continue
            entries = list(numbers({**values, **made}, whole))
            entries[index] = entry
            made[whole] = entries
    return made


def entries_of(free: Free) -> list[tuple[str, int | None]]:
    """Parameters that ``free`` and its followers are in, with the entry of a list."""
    return [_split(name) for name in (free.name, *(name for name, _ in free.followers))]


def _split(name: str) -> tuple[str, int | None]:
    if not name.endswith("]"):
        return name, None
    whole, index = name[:-1].split("[")
    return whole, int(index)
