# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tells friction level and presliding of a valve from a slow triangle of its voltage.

The derivation is in docs/explanation/identification.md. Sliding steadily, the spool is where
u = x/G + o ± (F + τ·v/G) puts it, with its static gain G, offset o, Coulomb friction F and the lag τ of the
valve. Behind each turn the voltage goes through the play of a magnet, if there is one; then the bristles turn
round: the friction follows the spool's way Δx as F·(1 - 2·exp(-Δx/δ)), with the presliding δ.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.ndimage
import scipy.optimize

from valve_control.arrays import Floats, Integers
from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification.experiment import BRIDGED, Experiment, held
from valve_control.design.identification.response import Response, Segment, phasor
from valve_control.parameter import ParameterError

TEST: dict[str, object] = {"scenario": "triangle", "amplitude": 4.0, "frequency": 0.2, "cycles": 9}
SHARE = 0.6  # of u_max, amplitude of a stepped sine beside it: above most friction
WHOLE = 0.9  # of the largest travel of the voltage, that a stroke has to have
EQUAL = 0.02  # by which strokes may differ in length
STRAIGHT = 0.02  # of the travel, by which they may be bent
LEAST_STROKES = 4
STEADY = (0.7, 0.97)  # part of a stroke that counts as steady sliding
WINDOW = 0.004  # s  over which readings are taken together
SMOOTH = 5  # windows over which the velocity is taken
PRESLIDING = (1e-3, 0.3)  # V  looked for
BEGUN = (0.005, 0.02, 0.08)  # V  preslidings from which the search begins
LEAST_FRICTION = 0.08  # V  below which presliding and play are not told
LEAST_WINDOWS = 20
SEEN, LEAST_WAY = 3.0, 5e-4  # times the noise and V, beyond which a way behind a turn counts
EXACT = 0.02  # V  beyond which a point of the turn counts less
BENT, BENT_LEAST = 0.06, 0.03  # share of the friction, and V, rms, by which the turn may differ from the fit
BEYOND = 1.2  # times the friction, which that of a fit may have
HARDLY = 1.01  # times the least presliding that is looked for, up to which none was seen
HIGHEST = 9  # harmonic of a stepped sine that is looked at
SETTLED = 0.4  # s
LEFT = 0.1  # share of the correction for friction and play that counts as its uncertainty
SLOWEST = 5.0  # lags of the valve, that a stroke takes at least between its turn and STEADY


class Friction(NamedTuple):
    """What a triangle tells of a valve."""

    coulomb: float  # V  Coulomb friction as input voltage
    presliding: float  # V  deflection of the bristles; 0.0: not to be told
    static_gain: float  # V/V  of the valve as it was tested
    offset: float  # V  input disturbance
    strokes: int  # that it comes from


class Shares(NamedTuple):
    """What play of the magnet and friction of the spool have of half the hysteresis."""

    play: float  # V  half width
    friction: float  # V
    presliding: float  # V


class Stroke(NamedTuple):
    """One stroke of a triangle."""

    first: int
    length: int  # samples
    direction: float  # 1.0 or -1.0


class Triangle(NamedTuple):
    """A slow triangle of the voltage."""

    voltage: Floats  # V
    reading: Floats  # V
    strokes: list[Stroke]  # whole ones of one length; not the first: bristles before it began at rest
    lag: float  # s  of slow motions behind the held voltage
    period: float  # s


def lag_of(model: TransferFunction, delay: float) -> float:
    """Time [s] by which slow motions lag behind the voltage, with a dead time ``delay`` [s]."""
    n, d = model.numerator, model.denominator
    return d[-2] / d[-1] - (n[-2] / n[-1] if len(n) > 1 else 0.0) + delay


def triangle_of(tested: Experiment, lag: float) -> Triangle:
    """The triangle of a test; ``lag`` [s]: see ``lag_of``. Raises ParameterError for another voltage."""
    voltage = held(tested.voltage)
    known = np.flatnonzero(np.isfinite(tested.position))
    if len(known) < 2 or not np.all(np.isfinite(voltage)):
        raise ParameterError("the friction test begins without voltages, or has no readings")
    if float(np.max(np.abs(voltage))) >= tested.u_max:
        raise ParameterError(f"the voltage of the friction test saturates at u_max, {tested.u_max:g} V")
    reading = np.interp(np.arange(len(voltage)), known, tested.position[known])
    return Triangle(voltage, reading, _strokes(voltage, known), lag + 0.5 * tested.period, tested.period)


def _strokes(voltage: Floats, known: Integers) -> list[Stroke]:
    steps = np.diff(voltage)
    moving = np.flatnonzero(steps != 0.0)
    directions = np.sign(steps[moving])
    turns = [0, *(np.flatnonzero(np.diff(directions) != 0.0) + 1), len(moving)]
    travel, whole = float(np.ptp(voltage)), []
    for a, b in pairwise(turns if len(moving) else []):
        first, end = int(moving[a]), int(moving[b - 1]) + 1
        readings = np.concatenate([[first], known[(known > first) & (known < end)], [end]])
        if abs(voltage[end] - voltage[first]) > WHOLE * travel and np.max(np.diff(readings)) <= BRIDGED + 1:
            whole.append(Stroke(first, end - first, float(directions[a])))
    lengths = [stroke.length for stroke in whole]
    if len(whole) <= LEAST_STROKES or max(lengths) - min(lengths) > 1.0 + EQUAL * max(lengths):
        raise ParameterError(
            f"the friction test has {len(whole)} whole strokes; its voltage must be a triangle with more "
            f"than {LEAST_STROKES} equal ones"
        )
    for first, length, _ in whole:
        line = np.linspace(voltage[first], voltage[first + length], length + 1)
        bent = float(np.max(np.abs(voltage[first : first + length + 1] - line)))
        if bent > STRAIGHT * travel:
            raise ParameterError(
                f"the voltage of the friction test is up to {bent:.2g} V beside straight lines; it must be a "
                "triangle"
            )
    return [stroke._replace(length=min(lengths)) for stroke in whole[1:]]


def friction(tested: Experiment, lag: float) -> Friction:
    """Friction from a triangle of the voltage; ``lag`` [s]: see ``lag_of``. Raises ParameterError."""
    t = triangle_of(tested, lag)
    first, length, _ = t.strokes[0]
    time = length * t.period
    if STEADY[0] * time < SLOWEST * t.lag:
        raise ParameterError(
            f"a stroke of the friction test takes {time:.3g} s; on this valve it must take "
            f"{SLOWEST * t.lag / STEADY[0]:.3g} s or more"
        )
    slope, offset, beyond = sliding(t)
    coulomb = max(0.0, beyond - t.lag * abs(t.voltage[first + length] - t.voltage[first]) / time)
    turn = shares(t, t.voltage - slope * t.reading - offset, slope, coulomb)
    return Friction(coulomb, 0.0 if turn is None else turn.presliding, 1.0 / slope, -offset, len(t.strokes))


def without(tested: Experiment, found: Friction, play: float = 0.0, coil: float = 0.0) -> Experiment:
    """``tested``, a stepped sine, with the voltage that friction and play take of each sample taken off.

    The friction is that of a bristle which the harmonics of the position drag. ``found`` without a
    presliding has one of PRESLIDING's lower bound. The ``play`` [V], half a hysteresis, is that of the
    force, which lags behind the voltage by the ``coil`` [s].
    """
    delta = found.presliding if found.presliding > 0.0 else PRESLIDING[0]
    voltage = tested.voltage.copy()
    for segment in tested.segments:
        position = _harmonics(tested, segment)
        if position is None:
            continue
        part = slice(segment.first, segment.end)
        rubbing = found.coulomb * _dragged(position, delta)
        voltage[part] -= rubbing
        if play > 0.0:
            voltage[part] -= _of_magnet(tested.voltage[part], rubbing, segment, tested.period, play, coil)
    return tested._replace(voltage=voltage)


def _of_magnet(
    voltage: Floats, rubbing: Floats, segment: Segment, period: float, play: float, coil: float
) -> Floats:
    """Voltage [V] that play and lag of the magnet take of a sine ``voltage``; ``rubbing`` [V]: of friction.

    Friction acts on the force, so that a voltage which makes up for it leads by the coil. For the sine alone
    that counts in a response.
    """
    turns = segment.frequency * period
    index = np.arange(segment.first, segment.end)
    known = np.isfinite(voltage)
    given = phasor(voltage[known], index[known], turns)[0]
    settled = slice(len(index) // 2, None)
    rubbed = phasor(rubbing[settled], index[settled], turns)[0]
    lead = 2j * math.pi * segment.frequency * coil
    force = abs(given / (1.0 + lead))
    taken = rubbed * lead + given * (1.0 - through_play(play / force) if force > play else 0.0)
    made: Floats = np.real(taken * np.exp(2j * math.pi * turns * index))
    return made


def through_play(share: float) -> complex:
    """Describing function of a play, of which half the width is this ``share`` of the amplitude, 0 to 1.

    J.-J. Slotine, W. Li, Applied Nonlinear Control (1991), section 5.2 (backlash).
    """
    turned = 1.0 - 2.0 * share
    root = math.sqrt(1.0 - turned * turned)
    return complex(0.5 + (math.asin(turned) + turned * root) / math.pi, -(root * root) / math.pi)


def unsure(measured: Response, seen: Response) -> Response:
    """``measured`` behind ``without``, with the uncertainty of its correction of the response ``seen``.

    Otherwise poles and zeros would explain the rest of friction and play.
    """
    taken = np.abs(measured.value - np.interp(measured.frequency, seen.frequency, seen.value))
    return measured._replace(deviation=np.hypot(measured.deviation, LEFT * taken))


def _harmonics(tested: Experiment, segment: Segment) -> Floats | None:
    """Position [V] of a stretch and one sample more by its steady odd harmonics; None: too few readings."""
    count = segment.end - segment.first
    steps = np.arange(count + 1)
    omega = 2.0 * math.pi * segment.frequency * tested.period
    order = max(1, min(HIGHEST, int(0.9 * math.pi / omega)))
    angles = np.outer(steps, omega * np.arange(1, order + 1, 2))
    basis = np.column_stack([np.ones(count + 1), np.cos(angles), np.sin(angles)])
    reading = tested.position[segment.first : segment.end]
    usable = np.isfinite(reading) & (steps[:-1] >= min(SETTLED / tested.period, 0.5 * count))
    if np.count_nonzero(usable) < 2 * basis.shape[1]:
        return None
    fitted: Floats = basis @ np.linalg.lstsq(basis[:-1][usable], reading[usable], rcond=None)[0]
    return fitted


def _dragged(position: Floats, delta: float) -> Floats:
    """Deflections of a bristle, over those of sliding, at the end of each step of ``position`` [V]."""
    z = 0.0
    found = np.empty(len(position) - 1)
    for k, way in enumerate((np.diff(position) / delta).tolist()):
        z = (z + way) / (1.0 + abs(way))
        found[k] = z
    return found


def sliding(t: Triangle) -> tuple[float, float, float]:
    """1/G [V/V], offset [V] and what the direction adds [V], from the steady part of all strokes."""
    rows, wanted = [], []
    for first, length, direction in t.strokes:
        part = slice(first + round(STEADY[0] * length), first + round(STEADY[1] * length))
        x = t.reading[part]
        rows.append(np.column_stack([x, np.ones(len(x)), np.full(len(x), direction)]))
        wanted.append(t.voltage[part])
    slope, offset, beyond = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    if not slope > 0.0:
        raise ParameterError("the spool of the friction test does not follow the voltage")
    return float(slope), float(offset), float(beyond)


def shares(t: Triangle, rest: Floats, slope: float, half: float) -> Shares | None:
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
    count = t.strokes[0].length // size
    strokes = [(slice(first, first + count * size), d) for first, _, d in t.strokes]
    whole = [np.mean([d * one[part] for part, d in strokes], axis=0) for one in (t.reading, rest)]
    x, w = (one.reshape(count, size).mean(axis=1) for one in whole)
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
