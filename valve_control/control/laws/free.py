# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes the numbers of a law that a tuner may choose: which, within what range, on what scale."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from valve_control.control.plant.transfer_functions import D3FXE, Scale
from valve_control.parameter import Value, Values, number, numbers

DIGITS = 4  # that are chosen, so that a file holds just what was tried


def one(values: Values) -> float:
    """Unit of a number that is counted in itself."""
    return 1.0


class Free(NamedTuple):
    """One number that may be chosen.

    Where another parameter says what is much or little, as the proportional gain does of the integral one,
    the number is counted in a ``unit`` that follows from it. So the range need not hold what never fits
    together.
    """

    name: str  # of a parameter, or name[i] for the entry i of a list
    low: float
    high: float
    logarithmic: bool = True  # scale: of the number's logarithm, or of the number itself
    followers: tuple[tuple[str, float], ...] = ()  # numbers that are always this one times a factor
    only: tuple[str, ...] = ()  # a parameter, and its values for which this number matters; (): always
    unit: Callable[[Values], float] = one  # of the number, from values of what stands before it in ``free``
    powers: tuple[int, int] = (0, 0)  # of speed and gain of the valve, with which the range goes

    def ranged(self, scale: Scale) -> "Free":
        """The same for a valve with this ``scale``; the range is that for the D3FXE."""
        if scale == D3FXE:
            return self
        factor = scale.speed ** self.powers[0] * scale.gain ** self.powers[1]
        return self._replace(low=self.low * factor, high=self.high * factor)

    def from_share(self, share: float) -> float:
        """The number at ``share``, 0 to 1, of the range."""
        share = min(1.0, max(0.0, share))
        if self.logarithmic:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        return _rounded(value)

    def to_share(self, value: float) -> float:
        """Where ``value`` lies in the range, 0 to 1; outside: the nearer end."""
        value = min(self.high, max(self.low, value))
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def matters(self, values: Values) -> bool:
        """Whether the number matters with these ``values`` of the controller."""
        return not self.only or values[self.only[0]] in self.only[1:]


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def present(free: Free, values: Values) -> float:
    """The number in ``values``."""
    name, index = _split(free.name)
    value = number(values, name) if index is None else float(numbers(values, name)[index])
    unit = free.unit(values)
    return value / unit if unit != 0.0 else 0.0


def placed(chosen: Sequence[tuple[Free, float]], values: Values) -> dict[str, Value]:
    """The parameters that change in ``values`` when each of the ``chosen`` numbers is put in its place."""
    made: dict[str, Value] = {}
    for free, counted in chosen:
        value = _rounded(counted * free.unit({**values, **made}))
        followers = [(name, _rounded(value * factor)) for name, factor in free.followers]
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
