# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks results against conditions such as ``e_rms<0.02``, for continuous integration."""

import difflib
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from valve_control.recordings.bags.errors import BagError

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
FORM = re.compile(rf"\s*([A-Za-z_][\w./]*)\s*(<=|>=|==|!=|<|>)\s*({NUMBER})\s*")
OPERATORS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}


class ExpectationResult(NamedTuple):
    """Whether one condition holds on one valve."""

    text: str
    valve: str
    value: float | None  # None where the bag has no such number
    met: bool


def figures(valve: Mapping[str, Any]) -> dict[str, float | None]:
    """Results of one valve by name, for conditions; ``e_rms`` and the like are those of the whole run."""
    flat: dict[str, float | None] = {}

    def add(prefix: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for key, entry in value.items():
                add(f"{prefix}.{key}" if prefix else str(key), entry)
        elif value is None or (isinstance(value, (int, float)) and not isinstance(value, bool)):
            flat[prefix] = value

    add("", valve)
    add("", valve["indices"] or dict.fromkeys(("e_M", "e_F", "e_rms", "u_rms", "c_u")))
    return flat


def check(text: str, valves: Mapping[str, Mapping[str, Any]]) -> list[ExpectationResult]:
    """Check ``name op number`` on every valve, or ``valve.name op number`` on one; a missing number fails.

    Raises BagError if the text is no condition or there is no such number.
    """
    found = FORM.fullmatch(text)
    if found is None:
        raise BagError(f"--expect takes a condition such as 'e_rms<0.02', not '{text}'")
    name, sign, limit = found[1], found[2], float(found[3])
    chosen = dict(valves)
    for valve in valves:
        if name.startswith(f"{valve}."):
            name, chosen = name[len(valve) + 1 :], {valve: valves[valve]}
            break
    outcomes = []
    for valve, results in chosen.items():
        known = figures(results)
        if name not in known:
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or known
            raise BagError(f"--expect {text}: there is no number '{name}'; there is {', '.join(near)}")
        value = known[name]
        met = value is not None and math.isfinite(value) and OPERATORS[sign](value, limit)
        outcomes.append(ExpectationResult(text, valve, value, met))
    return outcomes
