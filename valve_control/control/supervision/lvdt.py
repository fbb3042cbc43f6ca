# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Judges each LVDT reading: finite, in range, no faster than the spool can move, not frozen.

Equal readings are no fault by themselves: a quiet converter shows the same number while the spool moves
by less than one of its steps q. The scatter of the readings, the mean of -D·D' over successive second
differences D and D', tells noise from rounding. White noise of variance σ² gives 4σ². Rounding of a smooth
motion, and noise that a step hides, give at most q². Above 4q² the readings are noisy: equal ones in a row
then mean a frozen LVDT as soon as the voltage has moved. Below, it is frozen only if the spool must have
moved by several steps:

    it stopped dead, although force and friction need the distance v²/(2·(b0·(D + |w|) + a1·v)) to stop it;
    or the voltage pulls it by more than any disturbance D, |w| > D with w = u - y·a0/b0, and
    x'' = b0·(|w| - D) - a1·x' has led it away.
"""

import math
from typing import NamedTuple

SOUND = ""
PACE = 0.0032  # s  time constant of the speed that the next reading should have
RECALL = 0.3  # s  for which a surprise is remembered
USUAL = 2.0  # times the surprises of late are none
REACH = 0.01  # s in which a spool comes from rest to max_rate at the fastest; 50,000 V/s² with 500 V/s
SETTLED = 20  # readings from which the speed is known
NOISY = 4.0  # squared steps of the converter; scatter from which 20 equal readings are chance once in days
ROUNDING = 1e-7  # of the limit; smaller changes are rounding of a driver, no step of the converter
DEAD_TIME = 0.005  # s  for which the voltage must pull before the spool has to answer
MOST = 16.0  # squared steps that one leap of the readings adds to the scatter
STEPS = 3.0  # of the converter that a spool must have moved before a reading that stands is frozen
BRAKED = 0.05  # tolerances within which a spool may stop dead, however fine the converter
PUSHED = 3.0  # tolerances that a voltage beyond every disturbance must have moved a spool before that
INSIDE = 0.85  # of the limit; nearer to it a spool may stop dead at the end of its stroke
LATEST = 0.05  # s  by which readings that jumped may be late
TEXTS = {
    "lvdt_not_finite": "LVDT readings are not finite",
    "lvdt_out_of_range": "LVDT readings are out of range",
    "lvdt_jump": "LVDT readings jump faster than the spool can move",
    "lvdt_frozen": "LVDT readings stand still while the voltage moves: frozen LVDT or stuck spool",
    "lvdt_silent": "LVDT is silent",
    "stalled": "the controller's process stood still",
    "disagrees": "LVDT readings disagree with the voltage",
    "doubted": "LVDT readings were wrong; motion has not shown yet that they agree with the voltage again",
}


class Params(NamedTuple):
    """What counts as a believable reading."""

    limit: float  # V
    max_rate: float  # V/s
    tolerance: float  # V
    frozen_samples: int  # 0: not watched
    frozen_voltage: float  # V
    period: float  # s
    a1: float  # 1/s  of the valve's model
    a0: float  # 1/s²
    b0: float  # 1/s², 0: no model, readings of a quiet converter are not judged for being frozen
    disturbance: float  # V  largest friction and offset together, at most lvdt_trust.LARGEST of u_max


class Standing(NamedTuple):
    """What the readings' last digits say, and what a spool must have done since the readings are equal."""

    grain: float  # V  smallest change of the readings, the converter's step; 0: no change yet
    difference: float  # V  of the last two readings
    second: float  # V  of the last two differences
    scatter: float  # V²
    begun: float  # V/s  speed when the readings began to be equal
    pulled: int  # samples for which the voltage has pulled by more than any disturbance
    pushed_rate: float  # V/s  that the spool must have by then
    pushed: float  # V  and how far it must have moved


class State(NamedTuple):
    """What is remembered between two readings."""

    last: float | None  # V  the last reading that counts
    age: float  # s since then
    raw: float | None  # V  the last finite reading, believed or not
    jumped: bool
    equal: int  # samples for which readings have been the same
    lowest: float  # V  of the voltage meanwhile
    highest: float  # V
    frozen_at: float | None  # V
    known: int  # readings of which the course is known
    rate: float  # V/s  of that course
    surprise: float  # V  largest of late
    leap: float  # V  the last one that was none of a spool
    standing: Standing


NOTHING = State(
    None, 0.0, None, False, 0, 0.0, 0.0, None, 0, 0.0, 0.0, 0.0,
    Standing(0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0.0),
)  # fmt: skip


def followed(p: Params, s: Standing, step: float, rate: float, age: float) -> Standing:
    """State after one more reading, ``step`` [V] from the last one, which is ``age`` [s] old.

    ``rate`` [V/s]: speed before it.
    """
    samples = age / p.period + 0.5
    difference = step if samples < 2.0 else step / math.floor(samples)
    second = difference - s.difference
    most = MOST * s.grain * s.grain
    product = -second * s.second
    if abs(product) > most:
        product = math.copysign(most, product)
    scatter = s.scatter
    if difference != 0.0 or s.difference != 0.0 or s.second != 0.0:  # else readings stand, and tell nothing
        scatter += min(1.0, p.period / RECALL) * (product - scatter)
    if difference == 0.0:
        begun = s.begun
        if s.difference != 0.0:  # the filtered speed lags behind a spool that brakes
            begun = min(abs(rate), (abs(s.difference) + s.grain) / p.period)
        return Standing(s.grain, 0.0, second, scatter, begun, s.pulled, s.pushed_rate, s.pushed)
    step = abs(step)
    grain = s.grain
    if step > ROUNDING * p.limit:
        grain = step if s.grain == 0.0 else min(s.grain, step)
    return Standing(grain, difference, second, scatter, 0.0, 0, 0.0, 0.0)


def pulled(p: Params, s: Standing, pull: float, samples: int) -> Standing:
    """State after ``samples`` more periods at rest, in which the voltage pulls the spool by ``pull`` [V]."""
    excess = abs(pull) - p.disturbance
    if excess <= 0.0:
        return s._replace(pulled=0, pushed_rate=0.0, pushed=0.0)
    time = samples * p.period
    rate = (s.pushed_rate + time * math.copysign(p.b0 * excess, pull)) / (1.0 + time * p.a1)
    return s._replace(pulled=s.pulled + samples, pushed_rate=rate, pushed=s.pushed + time * rate)


def frozen(p: Params, s: Standing, reading: float, lowest: float, highest: float) -> bool:
    """Whether readings that have been equal for long enough are those of a frozen LVDT or a stuck spool.

    ``lowest``, ``highest`` [V]: of the voltage meanwhile.
    """
    if s.scatter > NOISY * s.grain * s.grain:
        return highest - lowest > p.frozen_voltage
    if p.b0 == 0.0:
        return False
    least = max(STEPS * s.grain, BRAKED * p.tolerance) if s.grain > 0.0 else p.tolerance
    at_stop = abs(reading) > INSIDE * p.limit
    outwards = at_stop and s.pushed * reading > 0.0
    if s.pulled * p.period >= DEAD_TIME and abs(s.pushed) > PUSHED * p.tolerance and not outwards:
        return True
    speed = s.begun - 2.0 * s.grain / PACE
    if speed <= 0.0 or at_stop:
        return False
    rest = reading * p.a0 / p.b0
    pull = max(abs(lowest - rest), abs(highest - rest))
    return speed * speed > 2.0 * (p.b0 * (p.disturbance + pull) + p.a1 * speed) * least


def lateness(s: State) -> str:
    """Part of a sentence: by how much readings are late that jumped back along their course."""
    late = -s.leap / s.rate if s.jumped and s.rate != 0.0 else 0.0
    return f", or are late by {1e3 * late:.0f} ms" if 0.001 < late < LATEST else ""


def step(
    p: Params, s: State, reading: float, missed: int, voltage: float, blocked: bool, elapsed: float
) -> tuple[str, State]:
    """``SOUND`` or the condition of what is wrong with ``reading`` [V].

    ``missed``: samples lost before it; ``voltage`` [V]: applied until now; ``blocked``: whether the
    voltage is off already, so that a reading is compared with the one just before it, not with the
    last believable one; ``elapsed`` [s]: real time since the reading before, 0.0 if unknown.
    """
    last, age, raw, had_jumped, equal, lowest, highest, frozen_at, known, rate, surprise, leap, standing = s
    speed = rate
    since = max((1 + missed) * p.period, elapsed)
    age += since
    if not math.isfinite(reading):
        return "lvdt_not_finite", s._replace(age=age)
    if abs(reading) > p.limit:
        return "lvdt_out_of_range", s._replace(age=age)
    jumped = last is not None and abs(reading - last) > p.max_rate * age + p.tolerance
    if blocked or jumped or last is None:
        known, rate, surprise, leap = 0, 0.0, 0.0, 0.0
    elif not had_jumped:
        # A spool has mass: the distance of a reading from where the speed of the ones before leads is small,
        # and much like those of late. In a longer time its speed may change, at most by max_rate in REACH.
        difference = reading - last
        off = difference - rate * age
        allowed = p.tolerance + USUAL * surprise
        if age > p.period:
            turned = 0.5 * p.max_rate / REACH * (age * age - p.period * p.period)
            allowed = allowed + 2.0 * abs(rate) * (age - p.period) + turned
        if known >= SETTLED and abs(off) > allowed:
            jumped, leap = True, off
        else:
            surprise = max(abs(off), surprise * (1.0 - min(1.0, age / RECALL)))
            rate += min(1.0, age / (PACE + age)) * (difference / age - rate)
            known += 1
    elif leap != 0.0 and raw is not None and (raw + rate * since - reading) / leap > 0.5:
        # A leap back to where the spool has gone meanwhile.
        had_jumped, known, rate, surprise, leap = False, 0, 0.0, 0.0, 0.0
    # Readings that go on smoothly from one that jumped have jumped too, however long ago that is.
    if not blocked and (
        jumped or (had_jumped and raw is not None and abs(reading - raw) <= p.max_rate * since + p.tolerance)
    ):
        return "lvdt_jump", State(
            last, age, reading, True, equal, lowest, highest, frozen_at, known, rate, surprise, leap, standing
        )
    if last is not None:
        standing = followed(p, standing, reading - last, speed, age)
    fault = SOUND
    if reading == frozen_at:
        fault = "lvdt_frozen"
    elif reading != last:
        fault = "lvdt_jump" if jumped else SOUND
        equal, lowest, highest, frozen_at = 0, voltage, voltage, None
    else:
        equal, frozen_at = equal + 1 + missed, None
        lowest, highest = min(lowest, voltage), max(highest, voltage)
        if p.b0 > 0.0:
            standing = pulled(p, standing, voltage - reading * p.a0 / p.b0, 1 + missed)
        if 0 < p.frozen_samples <= equal and frozen(p, standing, reading, lowest, highest):
            if blocked:
                equal, lowest, highest = 0, voltage, voltage
                standing = standing._replace(begun=0.0, pulled=0, pushed_rate=0.0, pushed=0.0)
            else:
                fault, frozen_at = "lvdt_frozen", reading
    return fault, State(
        reading, 0.0, reading, False, equal, lowest, highest, frozen_at, known, rate, surprise, leap, standing
    )
