# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes power spectra of error and voltage."""

from typing import NamedTuple

import numpy as np
from scipy.signal import welch

from valve_control.arrays import Floats

WINDOW = 4096  # samples of one stretch


class Spectrum(NamedTuple):
    """One-sided amplitude spectral density over frequency."""

    frequency: Floats  # Hz
    density: Floats  # V/√Hz


def spectrum(signal: Floats, period: float) -> Spectrum:
    """Welch's estimate for ``signal`` [V] sampled every ``period`` [s], its mean taken off."""
    if len(signal) < 8:
        return Spectrum(np.empty(0), np.empty(0))
    frequency, power = welch(signal, 1.0 / period, nperseg=min(WINDOW, len(signal)))
    return Spectrum(frequency[1:], np.sqrt(power[1:]))
