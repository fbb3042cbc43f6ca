# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds by how much time to shift one run so that its motion lies over that of another."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import correlate, correlation_lags, find_peaks

from valve_control.arrays import Floats
from valve_control.control.analysis.segments import motions

SMOOTH = 0.02  # s over which a signal is averaged before its rate is taken
ALIKE = 0.5  # correlation of the rates from which on two motions are the same
AS_GOOD = 0.98  # part of the best correlation from which on another place fits as well


class TimedSignal(NamedTuple):
    """A signal with its times, from which motion is recognised."""

    time: Floats  # s, in order
    value: Floats  # V
    period: float  # s

    @property
    def begin(self) -> float:
        """Time [s] at which it first moves; its first time if it never rests or never moves."""
        found = motions(self.value, self.period)
        return float(self.time[found[0].start]) if found else float(self.time[0])


def shift(of: TimedSignal, over: TimedSignal) -> tuple[float, bool]:
    """Time [s] to add to ``of`` so that its motion lies over that of ``over``, and whether they are alike.

    Motions that are not alike are laid together where they begin. Of places that fit equally well, as in a
    sine, it is the one nearest to that.
    """
    together = over.begin - of.begin
    step = max(of.period, over.period)
    rates = [_rate(motion, step) for motion in (over, of)]
    energy = float(np.sqrt(np.prod([np.sum(np.square(rate)) for rate in rates])))
    if not energy > 0.0:
        return together, False
    match = correlate(rates[0], rates[1], method="fft") / energy
    if not match.max() >= ALIKE:
        return together, False
    moves = correlation_lags(len(rates[0]), len(rates[1])) * step + (over.time[0] - of.time[0])
    peaks, _ = find_peaks(np.pad(match, 1), height=AS_GOOD * match.max())
    fits = moves[peaks - 1]
    return float(fits[np.argmin(np.abs(fits - together))]), True


def _rate(motion: TimedSignal, step: float) -> Floats:
    """Change of the smoothed signal in every ``step`` [s]."""
    count = round((motion.time[-1] - motion.time[0]) / step) + 1
    grid = motion.time[0] + np.arange(count) * step
    index = np.clip(np.searchsorted(motion.time, grid + 0.5 * step) - 1, 0, len(motion.time) - 1)
    width = max(1, round(SMOOTH / step)) | 1
    return np.diff(uniform_filter1d(motion.value[index], width, mode="nearest"))
