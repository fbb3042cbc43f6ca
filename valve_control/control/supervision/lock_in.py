# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures voltage and reading at the frequency of even cycles, and tells where the cycles come from.

Two windows in a row, each of whole cycles and weighted by Hann's 1 - cos, give the complex amplitudes U of
the voltage and Y of the reading (synchronous detection, lock-in). The phase of U in the second window against
the first corrects the frequency. With the valve's model G(s) = b0/(s² + a1·s + a0), held for half a sample:

    a limit cycle of law and valve has Y = g·G·U·exp(-jωτ), with the gain g of the valve over that of the
    model and the time τ by which the readings answer the voltage later than the model does;
    Y - G·U is what comes in through the reading.
"""

import math
from typing import NamedTuple

from valve_control.control.supervision import lvdt

CYCLES = 2.0  # of a window, at least
WINDOW = 0.12  # s  of a window, at least


class Sums(NamedTuple):
    """Complex amplitudes of one window before they are scaled, in phase and in quadrature."""

    voltage: float  # V
    voltage_lag: float  # V
    reading: float  # V
    reading_lag: float  # V


class State(NamedTuple):
    """A measurement; none is going on while ``frequency`` is 0."""

    frequency: float  # Hz
    length: float  # samples of a window
    taken: float  # samples of both
    first: Sums
    second: Sums
    level: float  # V  first voltage, which is taken out: a window of whole samples is not of whole cycles
    reading_level: float  # V  first reading, likewise


class LockInResult(NamedTuple):
    """What a finished measurement says."""

    frequency: float  # Hz
    gain: float  # -  of the valve over that of the model, which the cycles would need; 0.0: no model
    lag: float  # s  from the model's answer to the reading's, within one cycle
    hum: float  # V  amplitude of what comes in through the reading


SILENT = Sums(0.0, 0.0, 0.0, 0.0)
NOTHING = State(0.0, 0.0, 0.0, SILENT, SILENT, 0.0, 0.0)


def begun(frequency: float, period: float) -> State:
    """A measurement at ``frequency`` [Hz] with samples each ``period`` [s]."""
    cycles = max(CYCLES, math.ceil(WINDOW * frequency))
    return State(frequency, math.floor(cycles / (frequency * period) + 0.5), 0.0, SILENT, SILENT, 0.0, 0.0)


def step(s: State, voltage: float, reading: float, period: float) -> State:
    """State after one more sample with ``voltage`` and ``reading`` [V]; the same once it is finished."""
    if s.taken >= 2.0 * s.length:
        return s
    angle = 2.0 * math.pi * s.frequency * s.taken * period
    weight = 1.0 - math.cos(2.0 * math.pi * (s.taken % s.length) / s.length)
    c, d = weight * math.cos(angle), weight * math.sin(angle)
    level = voltage if s.taken == 0.0 else s.level
    reading_level = reading if s.taken == 0.0 else s.reading_level
    u, y = voltage - level, reading - reading_level
    second = s.taken >= s.length
    m = s.second if second else s.first
    m = Sums(
        m.voltage + c * u,
        m.voltage_lag + d * u,
        m.reading + c * y,
        m.reading_lag + d * y,
    )
    if second:
        return State(s.frequency, s.length, s.taken + 1.0, s.first, m, level, reading_level)
    return State(s.frequency, s.length, s.taken + 1.0, m, s.second, level, reading_level)


def finished(s: State) -> bool:
    """Whether both windows are complete."""
    return s.frequency > 0.0 and s.taken >= 2.0 * s.length


def found(p: lvdt.Params, s: State) -> LockInResult:
    """What the ``finished`` measurement says."""
    turn = math.atan2(s.first.voltage_lag, s.first.voltage) - math.atan2(
        s.second.voltage_lag, s.second.voltage
    )
    # Whole turns between the windows belong to ``frequency``, what is left of half a turn to its error.
    turn = (turn + math.pi) % (2.0 * math.pi) - math.pi
    frequency = s.frequency + turn / (2.0 * math.pi * s.length * p.period)
    omega = 2.0 * math.pi * frequency
    # The forced answer of the model to the voltage, x + jy as in exp(-jωt): lag counts as positive.
    real, imaginary = p.a0 - omega * omega, p.a1 * omega
    scale = p.b0 / (real * real + imaginary * imaginary)
    hold = 0.5 * omega * p.period
    c, d = math.cos(hold), math.sin(hold)
    u, v = s.second.voltage, s.second.voltage_lag
    along = scale * (real * c - imaginary * d)
    across = scale * (imaginary * c + real * d)
    x, y = along * u - across * v, across * u + along * v
    answer = x * x + y * y
    a, b = s.second.reading, s.second.reading_lag
    hum = math.sqrt((a - x) * (a - x) + (b - y) * (b - y)) / (0.5 * s.length)
    if answer == 0.0:
        return LockInResult(frequency, 0.0, 0.0, hum)
    lag = math.atan2(b * x - a * y, a * x + b * y) % (2.0 * math.pi) / omega
    return LockInResult(frequency, math.sqrt((a * a + b * b) / answer), lag, hum)
