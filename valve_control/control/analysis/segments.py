# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds the motions in the command of a run: the segments for which indices are given."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from valve_control.arrays import Floats

REST = 0.1  # s for which a command that has come to rest stays
STILL = 0.002  # part of the command's range within which it counts as at rest
LEAST = 1e-3  # V, likewise, at least


class Segment(NamedTuple):
    """Samples from ``start`` to before ``end``."""

    kind: str  # run, motion or parameters
    name: str
    start: int
    end: int


def motions(command: Floats, period: float) -> list[Segment]:
    """Motions of ``command`` [V], sampled every ``period`` [s]: all between two rests of 0.1 s or more."""
    width = max(2, round(REST / period))
    if len(command) <= width:
        return []
    still = max(LEAST, STILL * float(np.ptp(command)))
    # At sample k: how far the command goes within the rest that would begin there.
    ahead = -(width // 2)
    travel = maximum_filter1d(command, width, origin=ahead) - minimum_filter1d(command, width, origin=ahead)
    resting = np.zeros(len(command), dtype=np.int64)
    begins = np.flatnonzero(travel[: len(command) - width + 1] <= still)
    resting[begins] += 1
    resting[np.minimum(begins + width, len(command) - 1)] -= 1
    moving = np.cumsum(resting) <= 0
    moving[-1] = moving[-2]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving, [False]]).astype(np.int8)))
    return [
        Segment("motion", f"motion {i + 1}", int(start), int(end))
        for i, (start, end) in enumerate(zip(edges[::2], edges[1::2], strict=True))
    ]
