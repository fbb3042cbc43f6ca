# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tells the characteristic curve of a valve, in both directions, from a slow triangle of its voltage.

Play of the magnet and friction of the spool shift the two branches apart along the voltage; gain, overlap
and null belong to the mean of both. On each side of the middle, each stroke is a straight line
x = g·(u - e ± W): its slope is the gain of that side, the mean of its two directions the edge e of the
overlap, and half of their distance W what play and friction take together. The lag of slow motions is taken
off.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.stats

from valve_control.arrays import Floats
from valve_control.control.analysis.figures import Line, Plot, draw_columns
from valve_control.control.laws import linearisation
from valve_control.design.identification.experiment import Experiment
from valve_control.design.identification.friction import (
    HARDLY,
    PRESLIDING,
    Friction,
    Shares,
    Stroke,
    Triangle,
    friction,
    shares,
    sliding,
    triangle_of,
)
from valve_control.parameter import ParameterError, Values

POINTS = 100
STRAIGHT = (0.15, 0.8)  # of the end of a stroke, between which a side is a straight line
LEAST_POINTS = 20
CONFIDENCE = 0.95
END = 0.05  # of a stroke, in which it shows a stop ...
FLAT = 0.2  # ... where its slope is below this share of the gain
TOLD_OVERLAP, TOLD_GAIN = 0.05, 0.03  # V and share of the gain, from which on they are told beside bounds
SAME = 0.1  # of the friction, by which that of the curve may differ where its presliding is to count
TOLD_PLAY = 0.05  # V
DEAD = 0.05  # of the gain, slope of the table in an overlap: its inverse is steep there, and no step
STOPPED = 0.02  # of the gain, slope of the table behind a stop


class Bounded(NamedTuple):
    """A quantity with the half-width of its 95 % confidence interval."""

    value: float
    bound: float


class Side(NamedTuple):
    """One side of the middle."""

    gain: Bounded  # V/V
    edge: Bounded  # V  voltage from which on the spool moves to this side, mean of both directions
    stop: Bounded | None  # V  position at which the spool stands still; None: not reached


class Characteristic(NamedTuple):
    """The static curve."""

    voltage: Floats  # V, POINTS
    rising: Floats  # V, position with rising voltage
    falling: Floats  # V
    positive: Side
    negative: Side
    overlap: Bounded  # V  between the edges; below 0: underlap
    null: Bounded  # V  voltage in the middle of the overlap
    hysteresis: Bounded  # V  between rising and falling voltage at one position: 2·(play + friction)
    strokes: int
    shares: Shares | None = None  # of the hysteresis; None: not to be told

    @property
    def lopsided(self) -> bool:
        """Whether one gain and no overlap do not describe the curve."""
        ratio = self.positive.gain.value / self.negative.gain.value - 1.0
        unsure = math.hypot(*(s.gain.bound / s.gain.value for s in (self.positive, self.negative)))
        return abs(self.overlap.value) > max(TOLD_OVERLAP, self.overlap.bound) or abs(ratio) > max(
            TOLD_GAIN, unsure
        )


def characteristic(tested: Experiment, lag: float) -> Characteristic:
    """The curve from a triangle of the voltage; ``lag`` [s] of slow motions.

    Raises ParameterError unless there are two strokes in each direction that move the spool to both sides.
    """
    t = triangle_of(tested, lag)
    found = _curve(t)
    if found.overlap.value < -TOLD_OVERLAP:  # both sides act in an underlap
        return found
    slope, offset, _ = sliding(t)
    needed = slope * t.reading + offset
    if found.lopsided:  # in the middle of both directions, by the line of its side
        up, down = (
            t.reading / side.gain.value + side.edge.value for side in (found.positive, found.negative)
        )
        needed = np.where(t.reading > 0.0, up, down)
    return found._replace(shares=shares(t, t.voltage - needed, slope, 0.5 * found.hysteresis.value))


def with_friction(tested: Experiment, lag: float) -> tuple[Friction, Characteristic | None]:
    """Friction and curve from a triangle of the voltage; no curve if the spool moves to one side alone.

    An overlap and unequal gains look like friction and offset on strokes that end on one side each: where the
    curve has them, friction is half of its hysteresis and the offset its null. Raises ParameterError.
    """
    rubbing = friction(tested, lag)
    try:
        found = characteristic(tested, lag)
    except ParameterError:
        return rubbing, None
    if not found.lopsided:
        return rubbing, found
    level = max(0.0, 0.5 * found.hysteresis.value)
    return rubbing._replace(
        coulomb=level,
        presliding=rubbing.presliding if abs(rubbing.coulomb - level) < SAME * level else 0.0,
        static_gain=0.5 * (found.positive.gain.value + found.negative.gain.value),
        offset=-found.null.value,
    ), found


def _curve(t: Triangle) -> Characteristic:
    up, down = ([_static(t, one) for one in t.strokes if one.direction == d] for d in (1.0, -1.0))
    if min(len(up), len(down)) < 2:
        raise ParameterError("the characteristic curve needs two strokes of the voltage in each direction")
    low = max(float(np.min(u)) for u, _ in up + down)
    high = min(float(np.max(u)) for u, _ in up + down)
    grid = np.linspace(low, high, POINTS)
    rising, falling = (np.array([np.interp(grid, u, x) for u, x in part]) for part in (up, down))
    sides, widths = [], []
    for sign in (1.0, -1.0):
        lines = [np.array([_line(u, x, sign) for u, x in part]) for part in (up, down)]
        gain = _mean(np.concatenate([part[:, 0] for part in lines]))
        rises, falls = (_mean(part[:, 1]) for part in lines)
        edge = _middle(rises, falls)
        widths.append(Bounded(rises.value - falls.value, 2.0 * edge.bound))
        sides.append(Side(gain, edge, _stop(up if sign > 0.0 else down, sign, gain.value)))
    positive, negative = sides
    null = _middle(positive.edge, negative.edge)
    return Characteristic(
        voltage=grid,
        rising=np.mean(rising, axis=0),
        falling=np.mean(falling, axis=0),
        positive=positive,
        negative=negative,
        overlap=Bounded(positive.edge.value - negative.edge.value, 2.0 * null.bound),
        null=null,
        hysteresis=_middle(*widths),
        strokes=len(t.strokes),
    )


def _middle(one: Bounded, other: Bounded) -> Bounded:
    return Bounded(0.5 * (one.value + other.value), 0.5 * math.hypot(one.bound, other.bound))


def _static(t: Triangle, stroke: Stroke) -> tuple[Floats, Floats]:
    """Voltage [V] that the spool answers in a stroke, rising, and the reading [V] at each."""
    first, length, direction = stroke
    u, x = t.voltage[first : first + length], t.reading[first : first + length]
    rate = abs(float(u[-1] - u[0])) / (t.period * max(1, length - 1))
    order = np.argsort(u, kind="stable")
    return u[order] - direction * rate * t.lag, x[order]


def _line(u: Floats, x: Floats, sign: float) -> tuple[float, float]:
    """Gain [V/V] and voltage [V] at 0 V of the straight part of a stroke on the side ``sign``."""
    end = float(np.max(sign * x))
    part = (sign * x > STRAIGHT[0] * end) & (sign * x < STRAIGHT[1] * end)
    if end <= 0.0 or np.count_nonzero(part) < LEAST_POINTS:
        side = "above" if sign > 0.0 else "below"
        raise ParameterError(f"the spool does not move {side} 0 V in a stroke of the slow triangle")
    # Noise is in the reading, the voltage is exact.
    gain, at_zero = np.polyfit(u[part], x[part], 1)
    if not gain > 0.0:
        raise ParameterError("the spool of the slow triangle does not follow the voltage")
    return float(gain), float(-at_zero / gain)


def _stop(strokes: Sequence[tuple[Floats, Floats]], sign: float, gain: float) -> Bounded | None:
    """Position [V] of a stop on the side ``sign`` at the end of ``strokes``; None: they do not reach it."""
    ends, slopes = [], []
    for u, x in strokes:
        count = max(LEAST_POINTS, round(END * len(u)))
        last = slice(-count, None) if sign > 0.0 else slice(count)
        slopes.append(float(np.polyfit(u[last], x[last], 1)[0]))
        ends.append(float(np.mean(x[last])))
    return _mean(np.array(ends)) if np.mean(slopes) < FLAT * gain else None


def _mean(values: Floats) -> Bounded:
    """Mean of the strokes' ``values`` with the half-width of its 95 % confidence interval."""
    quantile = float(scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, len(values) - 1))
    return Bounded(float(np.mean(values)), quantile * float(scipy.stats.sem(values)))


def notes(found: Characteristic) -> list[str]:
    """What the curve has beside one gain and friction, as sentences."""
    sentences = []
    if found.lopsided:
        sentences.append(
            f"the curve has an overlap of {found.overlap.value:.3g} ± {found.overlap.bound:.2g} V and gains "
            f"of {found.positive.gain.value:.4g} and {found.negative.gain.value:.4g} V/V above and below; "
            "the model has one gain and no overlap"
        )
    if found.shares is not None and found.shares.play > TOLD_PLAY:
        unseen = found.shares.presliding <= HARDLY * PRESLIDING[0]
        either = ", or friction without presliding, which looks the same" if unseen else ""
        sentences.append(
            f"{found.shares.play:.2g} V of the friction are play (hysteresis of the magnet){either}: "
            "the model has no play and takes both for friction"
        )
    return sentences


def parameters(found: Characteristic, gain: float, u_max: float) -> Values:
    """``linearisation.*`` of the curve for a law whose model has the static ``gain`` [V/V].

    x = g₊·max(0, u - e₊) + g₋·min(0, u - e₋) with the gains and edges of both sides is the curve of an
    overlap and of an underlap. Raises ParameterError if no inverse can be made of it.
    """
    stroke = float(found.voltage[-1] - found.voltage[0])
    if not found.hysteresis.value < stroke:
        raise ParameterError(
            f"the hysteresis of {found.hysteresis.value:.3g} V is as wide as the stroke of {stroke:.3g} V of "
            "the voltage; the friction test must go further"
        )
    points: dict[float, float] = {}
    for side, other, sign in ((found.negative, found.positive, -1.0), (found.positive, found.negative, 1.0)):
        g, e = side.gain.value, side.edge.value
        if sign * (e - other.edge.value) > 0.0:  # overlap: from the null to where a flat line meets the side
            flat = DEAD * gain
            begin = (g * e - flat * found.null.value) / (g - flat)
        else:
            begin = other.edge.value
        points[begin] = g * (begin - e)
        end = sign * u_max
        stop = end if side.stop is None else e + side.stop.value / g
        if sign * (end - stop) > 0.0 and sign * (stop - begin) > 0.0:
            points[stop] = g * (stop - e)
            points[end] = points[stop] + STOPPED * gain * (end - stop)
        elif sign * (end - begin) > 0.0:
            points[end] = g * (end - e)
    made: Values = {
        "linearisation.enabled": True,
        "linearisation.voltage": sorted(points),
        "linearisation.position": [points[u] for u in sorted(points)],
        "linearisation.gain": gain,
    }
    linearisation.seen({**made, "u_max": u_max})
    return made


def known_part(value: float, bound: float = 1e-4) -> float:
    """``value`` up to the first digit of its ``bound``: no test tells a voltage of 3.22e-5 V."""
    digits = -math.floor(math.log10(bound)) if 0.0 < bound < math.inf else 17
    return round(value, digits) + 0.0


def text(found: Characteristic) -> str:
    """The curve in a few lines for the terminal."""
    above, below, overlap, null, hysteresis = (
        f"{known_part(one.value, one.bound):.4g} ± {one.bound:.2g} V"
        for one in (found.positive.gain, found.negative.gain, found.overlap, found.null, found.hysteresis)
    )
    low, high = (
        "not reached" if side.stop is None else f"{side.stop.value:.3g} V"
        for side in (found.negative, found.positive)
    )
    lines = [
        f"characteristic: gain {above}/V above, {below}/V below ({found.strokes} strokes)",
        f"  overlap {overlap}, null {null}, hysteresis {hysteresis}",
        f"  stops: {low} below, {high} above",
    ]
    if found.shares is not None:
        play, friction, presliding = found.shares
        lines.append(
            f"  half of the hysteresis: play {play:.3g} V, friction {friction:.3g} V with a presliding of "
            f"{1e3 * presliding:.3g} mV"
        )
    return "\n".join(lines)


def draw(found: Characteristic, path: str) -> None:
    """Draw both directions and the lines of both sides, as the file ``path``. Raises OSError."""
    lines = [
        Line("rising voltage", found.voltage, found.rising),
        Line("falling voltage", found.voltage, found.falling),
    ]
    for side, end in ((found.positive, found.voltage[-1]), (found.negative, found.voltage[0])):
        at = np.array([side.edge.value, end])
        label = f"{side.gain.value:.3g} V/V from {side.edge.value:.3g} V on"
        lines.append(Line(label, at, side.gain.value * (at - side.edge.value), "black", True))
    draw_columns([Path(path)], {"": [Plot("position [V]", lines)]}, "voltage [V]", "characteristic curve")
