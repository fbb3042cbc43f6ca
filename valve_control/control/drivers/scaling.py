# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Turns signals of a device into volts of LVDT signal and back: one word or formula for each."""

import math
import re
from typing import NamedTuple

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
FORMULA = re.compile(rf"\*\s*(?P<factor>{NUMBER})\s*(?P<offset>[+-]\s*{NUMBER.removeprefix('[+-]?')})?")


FULL = 10.0  # V


class ScaleError(ValueError):
    """Says why a scale cannot be used; the message is one sentence for the user."""


class Scale(NamedTuple):
    """volts = factor · signal + offset."""

    factor: float  # V per unit of the signal, not 0
    offset: float = 0.0  # V

    def volts(self, signal: float) -> float:
        """Volts of ``signal``."""
        return self.factor * signal + self.offset

    def signal(self, volts: float) -> float:
        """Signal that has ``volts``."""
        return (volts - self.offset) / self.factor

    @property
    def live_zero(self) -> float:
        """Signal below which a wire is broken (NAMUR NE 43: 3.6 of 4 mA), -inf where 0 is a signal too."""
        least = min(self.signal(-FULL), self.signal(FULL))
        return 0.9 * least if least > 0.0 else -math.inf

    def reversed(self) -> "Scale":
        """The scale of the other polarity."""
        return Scale(-self.factor, -self.offset)

    def __str__(self) -> str:
        offset = f"{self.offset:+g}" if self.offset else ""
        return f"*{self.factor:g}{offset}"


WORDS = {
    "V": Scale(1.0),
    "-10..10V": Scale(1.0),
    "%": Scale(0.1),
    "0..10V": Scale(2.0, -10.0),
    "4..20mA": Scale(1.25, -15.0),  # of mA
}


def parse(text: str) -> Scale:
    """Scale of a word (V, -10..10V, %, 0..10V, 4..20mA) or formula (``*1.25-15``). Raises ScaleError.

    The words' range is −10 to 10 V: −100 to 100 %, 0 to 10 V, 4 to 20 mA.
    """
    word = text.strip()
    if word in WORDS:
        return WORDS[word]
    found = FORMULA.fullmatch(word)
    factor = float(found["factor"]) if found else math.nan
    offset = float((found["offset"] or "0").replace(" ", "")) if found else math.nan
    if not (math.isfinite(factor) and math.isfinite(offset)) or factor == 0.0:
        raise ScaleError(
            f"'{text}' is no scale; it must be {', '.join(WORDS)}, or *factor±offset with two finite "
            "numbers, volts per unit (not 0) and volts, such as *1.25-15"
        )
    return Scale(factor, offset)
