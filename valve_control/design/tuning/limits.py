# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Counts which limits of tuning are missed, by how many sets of gains or valves, and the best that was seen.

The limits have three ranks. Stability and margins are hard. Saturation, rest and pauses are hard where they
can be kept: by a set of the search, or by the gains from before it. Overshoot and chatter are wishes: a
result that misses one says so.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.linear.margins import EDGE, Margins
from valve_control.design.tuning.trial import TuningLimits

MARGINS = "hard"
KEPT = "hard where it can be kept"
WISH = "wish"


class Limit(NamedTuple):
    """One limit: how it is called, shown and ranked."""

    name: str
    unit: str
    scale: float  # shown over kept
    at_most: bool
    rank: str


LIMITS = (
    Limit("largest pole", "", 1.0, True, MARGINS),
    Limit("gain margin", "dB", 1.0, False, MARGINS),
    Limit("gain margin downwards", "dB", 1.0, False, MARGINS),
    Limit("phase margin", "deg", 1.0, False, MARGINS),
    Limit("delay margin", "ms", 1e3, False, MARGINS),
    Limit("sensitivity peak", "dB", 1.0, True, MARGINS),
    Limit("swing", "V", 1.0, True, MARGINS),
    Limit("saturation", "%", 100.0, True, KEPT),
    Limit("pause", "ms", 1e3, False, KEPT),
    Limit("not at rest", "%", 100.0, True, KEPT),
    Limit("overshoot", "%", 100.0, True, WISH),
    Limit("chatter", "", 1.0, True, WISH),
)


def asked(limits: TuningLimits, chatter: float | None = None) -> dict[str, float]:
    """The limits by name; what is not asked for is infinite, or 0."""
    return {
        "largest pole": 1.0 + EDGE,
        "gain margin": limits.gain_db,
        "gain margin downwards": limits.gain_db,
        "phase margin": limits.phase_deg,
        "delay margin": limits.delay_s,
        "sensitivity peak": limits.sensitivity_db,
        "swing": limits.swing,
        "saturation": limits.saturated,
        "pause": limits.pause_s,
        "not at rest": 0.0,
        "overshoot": limits.overshoot,
        "chatter": math.inf if chatter is None else chatter,
    }


def of_margins(found: Margins) -> dict[str, float]:
    """The margins of the worst of the valves, by the name of their limit."""
    return {
        "largest pole": float(np.max(found.radius)),
        "gain margin": float(np.min(found.gain_db)),
        "gain margin downwards": float(np.min(found.reduction_db)),
        "phase margin": float(np.min(found.phase_deg)),
        "delay margin": float(np.min(found.delay_s)),
        "sensitivity peak": float(np.max(found.sensitivity_db)),
        "swing": float(np.max(found.swing_v)),
    }


class Count(NamedTuple):
    """How often a limit was looked at and missed, and the best value."""

    seen: int
    missed: int
    best: float


Counts = dict[str, Count]


def count(counts: Counts, wanted: Mapping[str, float], values: Mapping[str, float]) -> None:
    """Add the ``values`` of one set of gains, or of one valve, to ``counts``."""
    for limit in LIMITS:
        value = values.get(limit.name)
        if value is None:
            continue
        most = wanted[limit.name]
        missed = value > most if limit.at_most else value < most
        before = counts.get(limit.name, Count(0, 0, value))
        best = min(before.best, value) if limit.at_most else max(before.best, value)
        counts[limit.name] = Count(before.seen + 1, before.missed + bool(missed or math.isnan(value)), best)


def together(several: Sequence[Counts]) -> Counts:
    """The sum of ``several``."""
    made: Counts = {}
    for limit in LIMITS:
        there = [counts[limit.name] for counts in several if limit.name in counts]
        if there:
            best = (min if limit.at_most else max)(one.best for one in there)
            made[limit.name] = Count(sum(c.seen for c in there), sum(c.missed for c in there), best)
    return made


def as_rows(counts: Counts, wanted: Mapping[str, float]) -> list[dict[str, Any]]:
    """For JSON: one row for each limit that was looked at; without end: None."""

    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return [
        {
            "limit": limit.name,
            "rank": limit.rank,
            "wanted": finite(wanted[limit.name]),
            "looked_at": counts[limit.name].seen,
            "missed": counts[limit.name].missed,
            "best": finite(counts[limit.name].best),
        }
        for limit in LIMITS
        if limit.name in counts
    ]


def as_text(rows: Sequence[Mapping[str, Any]], what: str) -> list[str]:
    """Lines of a table of ``rows`` as for JSON, counted in ``what``, such as "sets of gains"."""
    shown = {limit.name: limit for limit in LIMITS}

    def text(limit: Limit, value: float | None, missing: str) -> str:
        return missing if value is None else f"{limit.scale * value:.3g} {limit.unit}".rstrip()

    lines = [f"{'limit':24}{'wanted':>14}{'missed by':>12}{'of':>8}{'best':>14}   ({what})"]
    for row in rows:
        limit = shown[row["limit"]]
        sign = "<= " if limit.at_most else ">= "
        wanted = "none" if row["wanted"] is None else sign + text(limit, row["wanted"], "")
        best = text(limit, row["best"], "without end")
        lines.append(f"{limit.name:24}{wanted:>14}{row['missed']:12d}{row['looked_at']:8d}{best:>14}")
    return lines
