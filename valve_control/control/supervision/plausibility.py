# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compares LVDT readings with the voltage by a model of the valve: finds a wrong sign or gain, in motion.

A reading asks for the voltage w = (y'' + a1·y' + a0·y)/b0; of a sound LVDT that is the applied voltage plus a
disturbance, of one with the wrong sign it is minus that. Two outputs are correlated with the voltage u, both
through the same low-pass filter and over moved time only:

    w, in phase with u at all frequencies if the model is right;
    z = y + y'/a1, in phase within 90° whatever a0 and b0 are: (1 + s/a1)/(s² + a1·s + a0) is positive real.

A wrong sign turns both round, and w also where friction, which has the sign of the velocity, is taken out;
friction, offset, flow force, dead time and a wrong model do not turn all of them.
See docs/explanation/plausibility.md; answer.py judges a voltage beyond every disturbance.
"""

import math
from typing import NamedTuple

# In units of 1/√a0, the valve's own time
BLOCK = 0.14  # readings are averaged over this
LOW_PASS = 0.4  # time constant of each of the three stages
LAG = 0.1  # of the voltage on its way through amplifier, valve and LVDT
FORGET = 10.0  # of the correlations, moved time
WARM = 3.0  # after a start of the filters
EVIDENCE = 1.2  # of correlation beyond AGAINST, times moved time
AGAINST = 0.3  # correlation that a sound LVDT is allowed to have with the wrong sign
LEAST = 6.0  # blocks of motion before anything is concluded
AGREED = 75.0  # blocks of motion after a doubt, from which readings may be found sound again
CLEAR = 1.3  # factor of the slope that is no doubt
SAME = 1.4  # factor that is none after twice as many blocks, when the slope is better known
SMOOTH = 0.005  # of the usual slope, for each block
SOUND = -0.8  # wrongness below which a slope is worth keeping
TURNS = 0.3  # variance of the sign of the velocity from which friction can be told from an offset
ONE_WAY = 1e-6  # variance of that sign below which all motion went one way, and friction is constant

TEXTS = {
    "": "",
    "wrong_sign": "wrong sign",
    "unanswered": "the spool does not follow it: supply off, stuck spool or dead LVDT",
}


class Params(NamedTuple):
    """What readings of a sound LVDT on a sound valve may show."""

    block: float  # samples
    span: float  # s  of a block
    low_pass: float  # -  gain of a stage for one block
    lag: float  # -  of the voltage's further stage
    keep: float  # -  what is left of the sums after a block
    warm: float  # blocks
    a1: float  # 1/s
    a0: float  # 1/s²
    b0: float  # 1/s²
    slow: float  # V/s  what moves slower counts as at rest
    excitation: float  # V  least standard deviation from which is concluded
    evidence: float  # s


class Sums(NamedTuple):
    """Sums over blocks in which the spool moved, with forgetting; s is the sign of its velocity."""

    n: float
    u: float
    uu: float
    z: float
    zz: float
    uz: float
    w: float
    ww: float
    uw: float
    s: float
    us: float
    ws: float


class Shown(NamedTuple):
    """What the blocks until now have shown.

    ``wrong_sign`` stays a float: recorded snapshots (``~/memory``) have it as 1.0 or 0.0.
    """

    y1: float  # V  stages of the low-pass filter
    y2: float
    y3: float
    velocity: float  # V/s
    u1: float  # V
    u2: float
    u3: float
    u4: float
    warm: float  # blocks until the filters have forgotten their start
    moved: float  # blocks of motion since then
    sums: Sums
    against: float  # s  evidence of a wrong sign
    wrong_sign: float  # 1.0 once that is certain
    usual: float  # -  slope in the long run, 0.0: not known yet


class Block(NamedTuple):
    """Data of a block for the watches beside this check."""

    position: float  # V  behind the low-pass filter
    velocity: float  # V/s  of ``position``
    filtered_voltage: float  # V  behind the same filter and the lag of the valve: at the time of ``position``
    settled: bool  # whether the filter has forgotten its start
    doubted: bool  # whether the readings were found wrong, and motion has not shown yet that they are sound
    command: float  # V  as the law got it, 0.0 without one
    voltage: float  # V  applied before its last reading
    second_difference: float  # V  of the readings at its end
    converter_step: float  # V


class State(NamedTuple):
    """What is remembered between two readings."""

    held: float  # samples of this block
    reading: float  # their sum, V
    voltage: float  # their sum, V
    shown: Shown


class Doubt(NamedTuple):
    """Evidence held against readings that were found wrong, until motion has shown that they are sound."""

    times: float  # that they were found wrong in a row
    until: float  # s  for which they are not believed
    usual: float  # -  slope before


TRUST = Doubt(0.0, 0.0, 0.0)
NOTHING = Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def design(theta: tuple[float, float, float], period: float, slow: float, excitation: float) -> Params:
    """Watch with the model ``theta`` (a1 [1/s], a0, b0 [1/s²]) at ``period`` [s]; the rest in V, V/s."""
    a1, a0, b0 = theta
    own = 1.0 / math.sqrt(a0)
    block = max(1.0, math.floor(BLOCK * own / period + 0.5))
    span = block * period
    return Params(
        block=block,
        span=span,
        low_pass=1.0 - math.exp(-span / (LOW_PASS * own)),
        lag=1.0 - math.exp(-span / (LAG * own)),
        keep=math.exp(-span / (FORGET * own)),
        warm=float(math.ceil(WARM * own / span)),
        a1=a1,
        a0=a0,
        b0=b0,
        slow=slow,
        excitation=excitation,
        evidence=EVIDENCE * own,
    )


def initial(p: Params, reading: float, voltage: float, usual: float = 0.0) -> State:
    """State at rest at ``reading`` [V] under ``voltage`` [V]; ``usual``: slope, if known from before."""
    shown = Shown(
        reading, reading, reading, 0.0, voltage, voltage, voltage, voltage, p.warm, 0.0,
        NOTHING, 0.0, 0.0, usual,
    )  # fmt: skip
    return State(0.0, 0.0, 0.0, shown)


def anew(s: State) -> State:
    """State ``s`` with its filters and usual slope, and no other evidence."""
    return s._replace(shown=s.shown._replace(moved=0.0, sums=NOTHING, against=0.0, wrong_sign=0.0))


def step(p: Params, s: State, reading: float, voltage: float, samples: float) -> State:
    """State after one ``reading`` [V], before which ``voltage`` [V] was applied for ``samples`` periods."""
    held = s.held + samples
    readings = s.reading + samples * reading
    voltages = s.voltage + samples * voltage
    if held < p.block:
        return State(held, readings, voltages, s.shown)
    return State(0.0, 0.0, 0.0, _block(p, s.shown, readings / held, voltages / held))


def _block(p: Params, s: Shown, reading: float, voltage: float) -> Shown:
    """State after one more block with means ``reading`` [V] and ``voltage`` [V]."""
    y1 = s.y1 + p.low_pass * (reading - s.y1)
    y2 = s.y2 + p.low_pass * (y1 - s.y2)
    y3 = s.y3 + p.low_pass * (y2 - s.y3)
    u1 = s.u1 + p.low_pass * (voltage - s.u1)
    u2 = s.u2 + p.low_pass * (u1 - s.u2)
    u3 = s.u3 + p.low_pass * (u2 - s.u3)
    u4 = s.u4 + p.lag * (u3 - s.u4)
    velocity = (y3 - s.y3) / p.span
    warm, moved, sums = max(0.0, s.warm - 1.0), s.moved, s.sums
    against, usual = s.against, s.usual
    if s.warm == 0.0:
        w = ((velocity - s.velocity) / p.span + p.a1 * velocity + p.a0 * y3) / p.b0
        if abs(velocity) > p.slow:
            moved += 1.0
            sums = add(p.keep, sums, u4, y3 + velocity / p.a1, w, math.copysign(1.0, velocity))
            wrong = wrongness(p, sums)
            if moved >= LEAST:
                against = max(0.0, against + p.span * wrong)
            if moved >= 2.0 * AGREED and wrong < SOUND:
                present = slope(p, sums)
                if present > 0.0:
                    usual += max(SMOOTH, 1.0 / (moved - 2.0 * AGREED + 1.0)) * (present - usual)
    return Shown(
        y1, y2, y3, velocity, u1, u2, u3, u4, warm, moved, sums, against,
        1.0 if against > p.evidence else s.wrong_sign, usual,
    )  # fmt: skip


def add(keep: float, m: Sums, u: float, z: float, w: float, s: float) -> Sums:
    """Sums ``m`` with one more block."""
    return Sums(
        keep * m.n + 1.0,
        keep * m.u + u,
        keep * m.uu + u * u,
        keep * m.z + z,
        keep * m.zz + z * z,
        keep * m.uz + u * z,
        keep * m.w + w,
        keep * m.ww + w * w,
        keep * m.uw + u * w,
        keep * m.s + s,
        keep * m.us + u * s,
        keep * m.ws + w * s,
    )


def wrongness(p: Params, m: Sums) -> float:
    """How far all correlations lie below -AGAINST; negative if one does not. 0 for too little motion.

    Over whole cycles w goes up with the sign of the velocity, and friction, F·sgn y', adds to both
    correlations. Within part of a cycle w may go down with it, and F alone turns both round: there the third
    counts too, that of u with w once F·sgn y' is taken out of both.
    """
    least = m.n * m.n * p.excitation * p.excitation
    vu = m.n * m.uu - m.u * m.u
    vz = m.n * m.zz - m.z * m.z
    vw = m.n * m.ww - m.w * m.w
    if vu < least or vz < least or vw < least:
        return 0.0
    along = m.n * m.uw - m.u * m.w
    with_z = (m.n * m.uz - m.u * m.z) / math.sqrt(vu * vz)
    with_w = along / math.sqrt(vu * vw)
    spread = m.n * m.n - m.s * m.s
    us, ws = m.n * m.us - m.u * m.s, m.n * m.ws - m.w * m.s
    if ws < 0.0 and spread > ONE_WAY * m.n * m.n:
        vu, vw, along = vu - us * us / spread, vw - ws * ws / spread, along - us * ws / spread
        if vu < least or vw < least:
            return 0.0
        with_w = max(with_w, along / math.sqrt(vu * vw))
    return -AGAINST - max(with_z, with_w)


def slope(p: Params, m: Sums) -> float:
    """Voltage per voltage that the reading asks for, friction and offset taken out; 0.0: too little motion.

    A sound LVDT gives 1 over the valve's gain, in terms of the model's; one of r times its slope 1/r of that.
    """
    along, across, spread = m.n * m.uw - m.u * m.w, m.n * m.ww - m.w * m.w, m.n * m.n - m.s * m.s
    if spread > TURNS * m.n * m.n:
        us, ws = m.n * m.us - m.u * m.s, m.n * m.ws - m.w * m.s
        along, across = along - us * ws / spread, across - ws * ws / spread
    if across < m.n * m.n * p.excitation * p.excitation:
        return 0.0
    return along / across


def doubted(d: Doubt, s: State | None, now: float, first: float, longest: float) -> Doubt:
    """Doubt after one more finding at ``now`` [s]: lasts ``first`` [s], each time twice as long."""
    usual = d.usual if d.times > 0.0 else 0.0 if s is None else s.shown.usual
    return Doubt(d.times + 1.0, now + min(longest, first * 2.0 ** min(d.times, 30.0)), usual)


def ratio(p: Params, s: Shown, d: Doubt) -> float:
    """Gain of the LVDT over that before the doubt, as motion since then shows it; 0.0: not known yet."""
    if s.moved < AGREED:
        return 0.0
    present = slope(p, s.sums)
    if present <= 0.0:
        return 0.0
    found = d.usual / present if d.usual > 0.0 else 1.0
    return found if s.moved >= 2.0 * AGREED or max(found, 1.0 / found) < CLEAR else 0.0


def verdict(p: Params, s: State, d: Doubt) -> tuple[str, Doubt]:
    """Name of what is wrong with the readings after a block, "": nothing, and the doubt that remains."""
    if s.shown.wrong_sign > 0.0:
        return "wrong_sign", d
    found = ratio(p, s.shown, d) if d.times > 0.0 else 0.0
    if found <= 0.0:
        return "", d
    if max(found, 1.0 / found) < SAME:
        return "", TRUST
    return "gain", d


def words(name: str, p: Params, s: State, d: Doubt) -> str:
    """The ``name`` that ``verdict`` gave, in words."""
    return f"gain about {ratio(p, s.shown, d):.1g}" if name == "gain" else TEXTS[name]
