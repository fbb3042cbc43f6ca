# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Watches even cycles of the voltage: names their source, and when they have to be stopped.

oscillation.py finds them, lock_in.py measures them in voltage and reading while they last. Cycles of law and
valve are a limit cycle. Cycles at the frequency of the mains, and cycles that the valve cannot make from the
voltage, come in through the reading. Cycles that reach the limit of the voltage are switched off after a
while; the pause before the law tries again is twice as long each time.
"""

from typing import NamedTuple

from valve_control.control.supervision import lock_in, lvdt_trust, oscillation

BEGUN = 4.0  # cycles in a row from which they are measured
SATURATED = 0.9  # of the limit of the voltage
STOPPED = 12.0  # cycles in a row at the limit, after which they are switched off
LEAST = 0.6  # s  that they last, at least
CALM = 0.25  # cycles of the command for each of the voltage; more may be what a quick command brings about
FORGIVEN = 10.0  # s  after a pause, from which the next one is as short as the first
SPREAD = 4.0  # factor by which a valve's gain may differ from the model's in a limit cycle
WIDE = 10.0  # the same while the voltage saturates: a valve that is that much stronger may be unstable
EXACT = 1.0  # Hz  by which the measured frequency of a hum may differ from that of the mains
REPORTED_LAG = 0.003  # s
LIMIT_CYCLE = "oscillation"
HUM = "lvdt_hum"


class Params(NamedTuple):
    """What counts as cycles."""

    cycling: oscillation.Params
    full: oscillation.Params  # from one limit of the voltage to the other, whatever noise does between
    doubted: oscillation.Params  # the same while readings are doubted


class Pause(NamedTuple):
    """How often in a row cycles were switched off, and until when."""

    times: float
    until: float  # s


NEVER = Pause(0.0, -1.0)


def between(limit: float, period: float) -> oscillation.Params:
    """Cycles from one ``limit`` [V] of the voltage to the other."""
    return oscillation.Params(SATURATED * limit, period, 2.0 * SATURATED * limit)


def source(s: oscillation.State, found: lock_in.LockInResult, high: float, grain: float) -> str:
    """``HUM`` or ``LIMIT_CYCLE``; ``high`` [V]: amplitude of cycles that reach the limit of the voltage.

    ``grain`` [V]: step of the converter, half of which is what rounding alone may add to a reading.
    """
    if found.hum <= 0.5 * grain:
        return LIMIT_CYCLE
    if oscillation.amplitude(s) >= high:
        return HUM if found.gain > WIDE and mains(found.frequency) > 0.0 else LIMIT_CYCLE
    return HUM if found.gain > SPREAD or mains(found.frequency) > 0.0 else LIMIT_CYCLE


def unexplained(cycle: oscillation.State, swing: oscillation.State) -> bool:
    """Whether there are even cycles, small or from limit to limit, that the command does not have."""
    if cycle.cycles >= BEGUN and not oscillation.explained(cycle):
        return True
    return swing.cycles >= BEGUN and not oscillation.explained(swing)


def mains(frequency: float) -> float:
    """That of MAINS [Hz] which ``frequency`` [Hz] is, 0.0: none."""
    if frequency > 80.0:
        nearest = 100.0 if frequency < 110.0 else 120.0
    else:
        nearest = 50.0 if frequency < 55.0 else 60.0
    return nearest if abs(frequency - nearest) < EXACT else 0.0


def lasts(s: oscillation.State) -> bool:
    """Whether cycles at the limit of the voltage have gone on for long enough, under a calm command."""
    calm = s.turns <= 2.0 * CALM * s.cycles and s.departures <= CALM * s.cycles
    return calm and s.cycles >= STOPPED and s.maximum_time - s.since >= LEAST


def paused(p: lvdt_trust.Params, s: Pause, now: float) -> Pause:
    """State after cycles were switched off at ``now`` [s]."""
    times = 0.0 if now > s.until + FORGIVEN else s.times
    return Pause(times + 1.0, now + min(p.hold_off_limit, p.hold_off * 2.0 ** min(times, 30.0)))


def text(name: str, s: oscillation.State, found: lock_in.LockInResult) -> str:
    """One sentence about cycles from the source ``name``."""
    swing = f"voltage oscillates at {oscillation.frequency(s):.3g} Hz with {oscillation.amplitude(s):.2g} V"
    if name == LIMIT_CYCLE:
        return f"{swing}: limit cycle of law and valve"
    known = f" (mains: {mains(found.frequency):.0f} Hz)" if mains(found.frequency) > 0.0 else ""
    hum = f"{1e3 * found.hum:.2g} mV at {found.frequency:.3g} Hz{known}"
    return f"{swing}: {hum} come in through the LVDT reading"


def stop_text(name: str, s: oscillation.State, found: lock_in.LockInResult) -> str:
    """One sentence about cycles from the source ``name`` that were switched off."""
    said = f"{text(name, s, found)}, at the limit of the voltage"
    if name == LIMIT_CYCLE and REPORTED_LAG < found.lag < 0.75 / found.frequency:
        said += (
            f"; readings answer the voltage about {1e3 * found.lag:.2g} ms later than the model: dead time"
        )
    return said
