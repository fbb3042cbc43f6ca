# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tells friction and characteristic curve of a valve from a slow triangle of its voltage.

The derivation is in docs/explanation/identification.md. Sliding steadily, the spool is where
u = x/G + o ± (F + τ·v/G) puts it, with its static gain G, offset o, Coulomb friction F and the lag τ of the
valve. Behind each turn the voltage goes through the play of a magnet, if there is one; then the bristles turn
round: the friction follows the spool's way Δx as F·(1 - 2·exp(-Δx/δ)), with the presliding δ.

Gain, overlap and null of the curve belong to the mean of both directions. On each side of the middle, each
stroke is a straight line x = g·(u - e ± W): its slope is the gain of that side, the mean of its two
directions the edge e of the overlap, and half of their distance W what play and friction take together.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.ndimage
import scipy.optimize
import scipy.stats

from valve_control.arrays import Floats
from valve_control.control.analysis.figures import Line, Plot, draw_columns
from valve_control.control.laws import linearisation
from valve_control.design.identification.experiment import BRIDGED, Experiment, held
from valve_control.design.identification.friction import PRESLIDING, Friction
from valve_control.parameter import ParameterError, Values

POINTS = 100
STRAIGHT = (0.15, 0.8)  # of the end of a stroke, between which a side is a straight line
LEAST_POINTS = 20
CONFIDENCE = 0.95
TOLD_OVERLAP, TOLD_GAIN = 0.05, 0.03  # V and share of the gain, from which on they are told beside bounds
WHOLE = 0.9  # of the largest travel of the voltage, that a stroke has to have
EQUAL = 0.02  # by which strokes may differ in length
LEAST_BENT = 0.02  # of the travel, by which they may be bent
LEAST_STROKES = 4
STEADY = (0.7, 0.97)  # part of a stroke that counts as steady sliding
WINDOW = 0.004  # s  over which readings are taken together
SMOOTH = 5  # windows over which the velocity is taken
BEGUN = (0.005, 0.02, 0.08)  # V  preslidings from which the search begins
LEAST_FRICTION = 0.08  # V  below which presliding and play are not told
LEAST_WINDOWS = 20
SEEN, LEAST_WAY = 3.0, 5e-4  # times the noise and V, beyond which a way behind a turn counts
EXACT = 0.02  # V  beyond which a point of the turn counts less
BENT, BENT_LEAST = 0.06, 0.03  # share of the friction, and V, rms, by which the turn may differ from the fit
BEYOND = 1.2  # times the friction, which that of a fit may have
SAME = 0.1  # of the friction, by which that of the curve may differ where its presliding is to count
HARDLY = 1.01  # times the least presliding that is looked for, up to which none was seen
SLOWEST = 5.0  # lags of the valve, that a stroke takes at least between its turn and STEADY
DEAD = 0.05  # of the gain, slope of the table in an overlap: its inverse is steep there, and no step


class Shares(NamedTuple):
    """What play of the magnet and friction of the spool have of half the hysteresis."""

    play: float  # V  half width
    friction: float  # V
    presliding: float  # V


class Triangle(NamedTuple):
    """S whole strokes of n samples of a slow triangle; not the first: bristles before it began at rest."""

    voltage: Floats  # V  S×n
    reading: Floats  # V  S×n
    lag: float  # s  of slow motions behind the held voltage
    period: float  # s

    @property
    def rate(self) -> Floats:
        """Of the voltage in each stroke [V/s], S."""
        moved = self.voltage[:, -1] - self.voltage[:, 0]
        return np.asarray(moved / ((self.voltage.shape[1] - 1) * self.period))


class Bounded(NamedTuple):
    """A quantity with the half-width of its 95 % confidence interval."""

    value: float
    bound: float


class Side(NamedTuple):
    """One side of the middle."""

    gain: Bounded  # V/V
    edge: Bounded  # V  voltage from which on the spool moves to this side, mean of both directions


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


def friction_and_curve(tested: Experiment, lag: float) -> tuple[Friction, Characteristic | None]:
    """Friction and curve from a triangle of the voltage; no curve if the spool moves to one side alone.

    ``lag`` [s]: see ``friction.lag_of``. An overlap and unequal gains look like friction and offset on
    strokes that end on one side each: where the curve has them, friction is half of its hysteresis, the
    offset its null, and each position needs the voltage of its side. Raises ParameterError for another
    voltage.
    """
    t = _triangle(tested, lag)
    time = t.voltage.shape[1] * t.period
    if STEADY[0] * time < SLOWEST * t.lag:
        raise ParameterError(
            f"a stroke of the friction test takes {time:.3g} s; on this valve it must take "
            f"{SLOWEST * t.lag / STEADY[0]:.3g} s or more"
        )
    slope, offset, beyond = _sliding(t)
    level = max(0.0, beyond - t.lag * abs(float(t.rate[0])))
    found = Friction(level, 0.0, 1.0 / slope, -offset, len(t.voltage))
    needed, hidden = slope * t.reading + offset, False  # whether overlap or sides hide the presliding
    try:
        curve = _curve(t)
    except ParameterError:
        curve = None
    if curve is not None and curve.lopsided:  # in the middle of both directions, by the line of its side
        level = max(0.0, 0.5 * curve.hysteresis.value)
        hidden = abs(found.coulomb - level) >= SAME * level
        gain = 0.5 * (curve.positive.gain.value + curve.negative.gain.value)
        found = found._replace(coulomb=level, static_gain=gain, offset=-curve.null.value)
        up, down = (
            t.reading / side.gain.value + side.edge.value for side in (curve.positive, curve.negative)
        )
        needed = np.where(t.reading > 0.0, up, down)
    if curve is None or curve.overlap.value >= -TOLD_OVERLAP:  # both sides act in an underlap
        turn = _shares(t, t.voltage - needed, slope, level)
        found = found._replace(presliding=0.0 if turn is None or hidden else turn.presliding)
        curve = curve and curve._replace(shares=turn)
    return found, curve


def _triangle(tested: Experiment, lag: float) -> Triangle:
    """The triangle of a test; ``lag`` [s]: see ``lag_of``. Raises ParameterError for another voltage."""
    voltage = held(tested.voltage)
    known = np.flatnonzero(np.isfinite(tested.position))
    if len(known) < 2 or not np.all(np.isfinite(voltage)):
        raise ParameterError("the friction test begins without voltages, or has no readings")
    if float(np.max(np.abs(voltage))) >= tested.u_max:
        raise ParameterError(f"the voltage of the friction test saturates at u_max, {tested.u_max:g} V")
    steps = np.diff(voltage)
    moving = np.flatnonzero(steps != 0.0)
    turns = [0, *(np.flatnonzero(np.diff(np.sign(steps[moving])) != 0.0) + 1), len(moving)]
    travel, whole = float(np.ptp(voltage)), []
    for a, b in pairwise(turns if len(moving) else []):
        first, end = int(moving[a]), int(moving[b - 1]) + 1
        readings = np.concatenate([[first], known[(known > first) & (known < end)], [end]])
        even = np.max(np.diff(readings)) <= BRIDGED + 1 and not any(first < at <= end for at in tested.leaps)
        if even and abs(voltage[end] - voltage[first]) > WHOLE * travel:
            whole.append((first, end))
    lengths = [end - first for first, end in whole]
    if len(whole) <= LEAST_STROKES or max(lengths) - min(lengths) > 1.0 + EQUAL * max(lengths):
        raise ParameterError(
            f"the friction test has {len(whole)} whole strokes; its voltage must be a triangle with more "
            f"than {LEAST_STROKES} equal ones"
        )
    for first, end in whole:
        line = np.linspace(voltage[first], voltage[end], end - first + 1)
        bent = float(np.max(np.abs(voltage[first : end + 1] - line)))
        if bent > LEAST_BENT * travel:
            raise ParameterError(
                f"the voltage of the friction test is up to {bent:.2g} V beside straight lines; it must be a "
                "triangle"
            )
    reading = np.interp(np.arange(len(voltage)), known, tested.position[known])
    at = np.array(whole[1:])[:, :1] + np.arange(min(lengths))
    return Triangle(voltage[at], reading[at], lag + 0.5 * tested.period, tested.period)


def _sliding(t: Triangle) -> tuple[float, float, float]:
    """1/G [V/V], offset [V] and what the direction adds [V], from the steady part of all strokes."""
    part = slice(*(round(share * t.voltage.shape[1]) for share in STEADY))
    x = t.reading[:, part]
    direction = np.broadcast_to(np.sign(t.rate)[:, None], x.shape)
    rows = np.column_stack([x.ravel(), np.ones(x.size), direction.ravel()])
    slope, offset, beyond = np.linalg.lstsq(rows, t.voltage[:, part].ravel(), rcond=None)[0]
    if not slope > 0.0:
        raise ParameterError("the spool of the friction test does not follow the voltage")
    return float(slope), float(offset), float(beyond)


def _shares(t: Triangle, rest: Floats, slope: float, half: float) -> Shares | None:
    """Play and friction, together ``half`` [V], from the mean turn of all strokes, turned to rise.

    ``rest`` [V]: voltage minus the voltage that the position needs; ``slope``: 1/G [V/V]. Behind a turn the
    voltage first goes through the play while the spool stands still; then the bristles turn round with the
    way Δx of the spool. So w, what the voltage has beyond the position, is half - 2·F·exp(-Δx/δ), and its
    amplitude at Δx = 0 is that of the friction F alone. A spool that swings on its bristles at the turn
    shakes them loose: that is no exponential and tells nothing. None: not to be told.
    """
    if half < LEAST_FRICTION:
        return None
    size = max(1, round(WINDOW / t.period))
    count = t.voltage.shape[1] // size
    risen = [np.mean(np.sign(t.rate)[:, None] * one[:, : count * size], axis=0) for one in (t.reading, rest)]
    x, w = (one.reshape(count, size).mean(axis=1) for one in risen)
    velocity = scipy.ndimage.uniform_filter1d(np.gradient(x, size * t.period), SMOOTH, mode="nearest")
    w -= slope * t.lag * velocity
    noise = float(np.std(np.diff(x[-count // 4 :], 2))) / math.sqrt(6.0)
    turn = int(np.argmin(x[: len(x) // 2]))
    way, left = x[turn:] - x[turn], half - w[turn:]
    seen = (way > max(SEEN * noise, LEAST_WAY)) & (way < PRESLIDING[1])
    if np.count_nonzero(seen) < LEAST_WINDOWS:
        return None
    way, left = way[seen], left[seen]

    def misfit(p: Floats) -> Floats:
        return np.asarray(left - 2.0 * p[0] * np.exp(-way / p[1]))

    how = {
        "bounds": ([0.0, PRESLIDING[0]], [BEYOND * half, PRESLIDING[1]]),
        "loss": "soft_l1",
        "f_scale": EXACT,
    }
    searches = [scipy.optimize.least_squares(misfit, [0.5 * half, delta], **how) for delta in BEGUN]
    best = min(searches, key=lambda one: one.cost).x
    level, delta = (float(v) for v in best)
    bent = math.sqrt(float(np.mean(misfit(best) ** 2))) > max(BENT * half, BENT_LEAST)
    if bent and delta > HARDLY * PRESLIDING[0]:
        return None
    return Shares(max(0.0, half - level), min(half, level), delta)


def _curve(t: Triangle) -> Characteristic:
    static = t.voltage - t.rate[:, None] * t.lag  # the voltage that the spool answers
    orders = np.argsort(static, axis=1, kind="stable")  # rising
    sorted_u, sorted_x = (np.take_along_axis(one, orders, axis=1) for one in (static, t.reading))
    up, down = (
        [*zip(sorted_u[rising], sorted_x[rising], strict=True)] for rising in (t.rate > 0.0, t.rate < 0.0)
    )
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
        sides.append(Side(gain, edge))
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
        strokes=len(t.voltage),
    )


def _middle(one: Bounded, other: Bounded) -> Bounded:
    return Bounded(0.5 * (one.value + other.value), 0.5 * math.hypot(one.bound, other.bound))


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


def _mean(values: Floats) -> Bounded:
    """Mean of the strokes' ``values`` with the half-width of its 95 % confidence interval."""
    quantile = float(scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, len(values) - 1))
    return Bounded(float(np.mean(values)), quantile * float(scipy.stats.sem(values)))


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
        if sign * (end - begin) > 0.0:
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
    lines = [
        f"characteristic: gain {above}/V above, {below}/V below ({found.strokes} strokes)",
        f"  overlap {overlap}, null {null}, hysteresis {hysteresis}",
    ]
    if found.shares is not None:
        play, friction, presliding = found.shares
        unseen = presliding <= HARDLY * PRESLIDING[0]
        either = " (or friction without presliding, which looks the same)" if unseen else ""
        lines.append(
            f"  half of the hysteresis: play {play:.3g} V{either}, friction {friction:.3g} V with a "
            f"presliding of {1e3 * presliding:.3g} mV"
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
        label = f"{side.gain.value:.3g} V/V {'above' if end > 0.0 else 'below'} {side.edge.value:.2g} V"
        lines.append(Line(label, at, side.gain.value * (at - side.edge.value), "black", "--"))
    draw_columns([Path(path)], {"": [Plot("position [V]", lines)]}, "voltage [V]", "characteristic curve")
