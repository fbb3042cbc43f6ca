# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the limits of tuning with what measures each, and counts by how many sets of gains each is missed.

The limits have three ranks. Stability and margins are hard. Saturation, rest and pauses are hard where they
can be kept: by a set of the search, or by the gains from before it. Overshoot and chatter are wishes: a
result that misses one says so.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.laws.law import Law
from valve_control.control.linear.margins import EDGE, Margins
from valve_control.design.tuning import checks, trial
from valve_control.design.tuning.trial import GainSet, Problem, Threads, TuningLimits

MARGINS = "hard"
KEPT = "hard where it can be kept"
WISH = "wish"
Measure = Callable[[Law, Problem, Sequence[GainSet], Threads], list[float]]


class Limit(NamedTuple):
    """One limit: its name, size and rank, what measures it, and the sentence about gains that miss it."""

    name: str
    unit: str
    scale: float  # of the unit over that of the value
    at_most: bool
    rank: str
    wanted: str | float  # field of TuningLimits, or the limit itself
    reason: str  # with the {value} and the {limit} in the unit
    margin: str = ""  # field of Margins that it limits
    measure: Measure | None = None  # of several sets of gains, by runs of their own

    def asked(self, limits: TuningLimits) -> float:
        """The limit that is asked for; none: infinite, or 0.0."""
        return float(getattr(limits, self.wanted) if isinstance(self.wanted, str) else self.wanted)

    def value(self, law: Law, problem: Problem, gains: GainSet, threads: Threads = None) -> float:
        """The measured value of ``gains``. Raises ParameterError for gains that ``law`` cannot have."""
        assert self.measure is not None, f"{self.name} is measured with others"
        return self.measure(law, problem, [gains], threads)[0]

    def texts(self, row: Mapping[str, Any]) -> tuple[str, str]:
        """The limit that is wanted and the best value of a ``row`` as for JSON, with their unit."""
        finite = {key: math.isfinite(row[key]) for key in ("wanted", "best")}
        wanted, best = (f"{self.scale * row[key]:.3g} {self.unit}".rstrip() for key in finite)
        sign = "<=" if self.at_most else ">="
        return f"{sign} {wanted}" if finite["wanted"] else "none", best if finite["best"] else "without end"

    def missed(self, value: float, wanted: float) -> bool:
        """Whether a ``value`` misses the limit ``wanted``."""
        return not value <= wanted if self.at_most else value < wanted

    def sentence(self, value: float, wanted: float) -> str:
        """About a ``value`` that misses the limit ``wanted``."""
        return self.reason.format(value=self.scale * value, limit=self.scale * wanted)


def _margin(name: str, unit: str, scale: float, wanted: str, margin: str) -> Limit:
    reason = f"the {name} falls to {{value:.3g}} {unit} in the box, below {{limit:g}} {unit}"
    return Limit(name, unit, scale, False, MARGINS, wanted, reason, margin=margin)


UNSTABLE = "a valve of the box makes the loop unstable (largest pole {value:.4f})"
PEAK = "the sensitivity peaks at {value:.3g} dB, above {limit:g} dB"
SWING = "in the loop friction sustains swings about rest of {value:.3g} V, above {limit:g} V"
SATURATED = "the amplifier saturates in {value:.2g} % of the samples"
PAUSE = (
    "after a pause of the command of {limit:g} ms or less the reference does not come back while the motion "
    "lasts"
)
RESTLESS = (
    f"{{value:.2g}} % of the valves in the box do not rest within {checks.HELD:g} s after a step when "
    "half of the margins is gone"
)
OVERSHOT = "steps are overshot by {value:.3g} % on valves that were not seen, above {limit:g} %"
LOUD = "c_u is {value:.3f} on valves that were not seen, above {limit:g}"
LIMITS = (
    Limit("largest pole", "", 1.0, True, MARGINS, 1.0 + EDGE, UNSTABLE, margin="radius"),
    _margin("gain margin", "dB", 1.0, "gain_db", "gain_db"),
    _margin("gain margin downwards", "dB", 1.0, "gain_db", "reduction_db"),
    _margin("phase margin", "deg", 1.0, "phase_deg", "phase_deg"),
    _margin("delay margin", "ms", 1e3, "delay_s", "delay_s"),
    Limit("sensitivity peak", "dB", 1.0, True, MARGINS, "sensitivity_db", PEAK, "sensitivity_db"),
    Limit("swing", "V", 1.0, True, MARGINS, "swing", SWING, "swing_v"),
    Limit(
        "saturation", "%", 100.0, True, KEPT, "saturated", SATURATED,
        measure=lambda *about: [float(np.mean(one.saturated)) for one in trial.run(*about)],
    ),
    Limit("pause", "ms", 1e3, False, KEPT, "pause_s", PAUSE, measure=checks.unborne),
    Limit("not at rest", "%", 100.0, True, KEPT, 0.0, RESTLESS, measure=checks.restless_shares),
    Limit("overshoot", "%", 100.0, True, WISH, "overshoot", OVERSHOT, measure=checks.overshoots),
    Limit("chatter", "", 1.0, True, WISH, math.inf, LOUD),
)  # fmt: skip
BY_NAME = {limit.name: limit for limit in LIMITS}


def asked(limits: TuningLimits, chatter: float) -> dict[str, float]:
    """The limits by name, with that of the ``chatter``; what is not asked for is infinite, or 0."""
    return {**{limit.name: limit.asked(limits) for limit in LIMITS}, "chatter": chatter}


def of_margins(measured: Margins) -> dict[str, list[float]]:
    """The margins of each valve, by the name of their limit."""
    return {limit.name: getattr(measured, limit.margin).tolist() for limit in LIMITS if limit.margin}


def worst(values: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """The worst of the ``values`` for each limit."""
    return {name: float((np.max if BY_NAME[name].at_most else np.min)(v)) for name, v in values.items()}


def violation(limits: TuningLimits, found: Margins, share: float = 1.0) -> float:
    """By how much the worst valve misses the ``limits``, times ``share`` the margins; 0.0: they hold.

    Sum of what is missing of each as a part of it; an unstable loop misses more than any stable one.
    """
    missing = 0.0
    for name, value in worst(of_margins(found)).items():
        limit, wanted = BY_NAME[name], BY_NAME[name].asked(limits)
        if limit.margin == "radius":
            if value - 1.0 >= EDGE:
                return 10.0 + 100.0 * (value - 1.0)
        elif limit.margin == "swing_v":
            part = value / (wanted / share)
            missing += math.log(part) if part > 1.0 else 0.0
        elif limit.at_most:
            missing += max(0.0, value / (wanted / share) - 1.0)
        elif wanted > 0.0:
            missing += max(0.0, 1.0 - value / (wanted * share))
    return missing


def as_rows(values: Mapping[str, Sequence[float]], wanted: Mapping[str, float]) -> list[dict[str, Any]]:
    """For JSON: one row for each limit with ``values``, of sets of gains."""
    return [
        {
            "limit": limit.name,
            "rank": limit.rank,
            "wanted": wanted[limit.name],
            "looked_at": len(measured),
            "missed": sum(math.isnan(v) or limit.missed(v, wanted[limit.name]) for v in measured),
            "best": (min if limit.at_most else max)(measured),
        }
        for limit in LIMITS
        if (measured := values.get(limit.name))
    ]


def binding(rows: Sequence[Mapping[str, Any]], what: str) -> list[str]:
    """A sentence about the limit that most of ``what`` miss, of ``rows`` as for JSON; [] if none does."""
    row = max(rows, key=lambda row: row["missed"] / row["looked_at"], default=None)
    if row is None or not row["missed"]:
        return []
    limit, missed = BY_NAME[row["limit"]], f"{row['missed']} of {row['looked_at']}"
    wanted, best = limit.texts(row)
    return [f"the {limit.name} binds: {missed} {what} miss it, the best has {best} ({wanted})"]


def as_text(rows: Sequence[Mapping[str, Any]], what: str) -> list[str]:
    """Lines of a table of ``rows`` as for JSON, counted in ``what``, such as "sets of gains"."""
    lines = [f"{'limit':24}{'wanted':>14}{'missed by':>12}{'of':>8}{'best':>14}   ({what})"]
    for row in rows:
        wanted, best = BY_NAME[row["limit"]].texts(row)
        lines.append(f"{row['limit']:24}{wanted:>14}{row['missed']:12d}{row['looked_at']:8d}{best:>14}")
    return [*lines, *binding(rows, what)]
