# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Offset between two clocks from the delays of messages."""

import numpy as np
import pytest
from grids import grid

from valve_control.control.supervision import clock


def offsets(came, stamps):
    """Offset [s] after each message."""
    s, found = clock.NOTHING, []
    for time, stamp in zip(came, stamps, strict=True):
        s = clock.step(s, float(time), float(time - stamp))
        found.append(clock.offset(s))
    return np.array(found)


@grid("drift, jitter, period", [0.0, 1e-4, -1e-3], [0.0, 0.0001, 0.0014], [0.001, 0.01])
def test_offset_and_drift_are_found_from_the_smallest_delays(drift, jitter, period):
    stamps = np.arange(0.0, 10.0, period)
    sent = 50.0 + stamps * (1.0 + drift)
    came = np.maximum.accumulate(sent + np.random.default_rng(1).uniform(0.0, jitter, len(stamps)))
    wrong = (offsets(came, stamps) - (sent - stamps))[stamps > 6.0]
    share = 0.05 if period == 0.001 else 0.2  # of the jitter; fewer messages, a larger smallest delay
    assert np.max(np.abs(wrong)) < 1e-5 + share * jitter


@pytest.mark.parametrize("leap", [-3600.0, -0.03, 0.03, 3600.0])
def test_a_clock_that_is_set_is_followed(leap):
    """At once where it was set by more than LEAP; otherwise within two windows."""
    stamps = np.arange(0.0, 4.0, 0.001)
    sent = stamps + np.where(stamps < 2.0, 0.0, leap)
    wrong = np.abs(offsets(sent, stamps) - (sent - stamps))
    settled = 2.0 if leap < -clock.EARLY or leap > clock.LEAP else 3.2
    assert np.max(wrong[stamps > settled]) < 1e-3
