"""Judges each LVDT reading: finite, in range, no faster than the spool can move, not frozen."""

import math
from typing import NamedTuple

SOUND = ""
PACE = 0.0032  # s  time constant of the speed that the next reading should have
RECALL = 0.3  # s  for which a surprise is remembered
USUAL = 2.0  # times the surprises of late are none
REACH = 0.01  # s in which a spool comes from rest to max_rate at the fastest; 50,000 V/s² with 500 V/s
SETTLED = 20  # readings from which the speed is known
TEXTS = {
    "not_finite": "LVDT readings are not finite",
    "out_of_range": "LVDT readings are out of range",
    "jump": "LVDT readings jump faster than the spool can move",
    "frozen": "LVDT readings stand still while the voltage moves: frozen LVDT or stuck spool",
    "silent": "LVDT is silent",
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


NOTHING = State(None, 0.0, None, False, 0, 0.0, 0.0, None, 0, 0.0, 0.0, 0.0)


def step(
    p: Params, s: State, reading: float, missed: int, voltage: float, blocked: bool, elapsed: float
) -> tuple[str, State]:
    """``SOUND`` or the name of what is wrong with ``reading`` [V].

    ``missed``: samples lost before it; ``voltage`` [V]: applied until now; ``blocked``: whether the
    voltage is off already, so that a reading is compared with the one just before it, not with the
    last believable one; ``elapsed`` [s]: real time since the reading before, 0.0 if unknown.
    """
    last, age, raw, had_jumped, equal, lowest, highest, frozen_at, known, rate, surprise, leap = s
    since = (1 + missed) * p.period
    if elapsed > since:
        since = elapsed
    age += since
    if not math.isfinite(reading):
        return "not_finite", s._replace(age=age)
    if abs(reading) > p.limit:
        return "out_of_range", s._replace(age=age)
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
        return "jump", State(
            last, age, reading, True, equal, lowest, highest, frozen_at, known, rate, surprise, leap
        )
    fault = SOUND
    if reading == frozen_at:
        fault = "frozen"
    elif reading != last:
        fault = "jump" if jumped else SOUND
        equal, lowest, highest, frozen_at = 0, voltage, voltage, None
    else:
        equal, frozen_at = equal + 1 + missed, None
        lowest, highest = min(lowest, voltage), max(highest, voltage)
        if 0 < p.frozen_samples <= equal and highest - lowest > p.frozen_voltage:
            if blocked:
                equal, lowest, highest = 0, voltage, voltage
            else:
                fault, frozen_at = "frozen", reading
    return fault, State(
        reading, 0.0, reading, False, equal, lowest, highest, frozen_at, known, rate, surprise, leap
    )
