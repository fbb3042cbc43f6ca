# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of a loop's times."""

from valve_control.nodes.timing import WINDOW, Timing


def test_the_last_samples_give_the_spreads():
    """Every tenth reading is 0.5 ms late, the first of the last thousand too; one step takes two periods."""
    timing = Timing()
    assert timing.figures(0.001) == {}
    for k in range(2 * WINDOW):
        began = 0.001 * k + (0.0005 if k % 10 == 0 else 0.0)
        timing.note(began, began + (0.002 if k == 5 else 0.0001), 0.0002, 0.001)
    got = {name: float(text) for name, text in timing.figures(0.001).items()}
    assert (got["period_ms"], got["latency_ms_p50"], got["step_ms_max"]) == (0.9995, 0.2, 0.1)
    assert (got["jitter_ms_p50"], got["jitter_ms_p99"], got["jitter_ms_max"]) == (0.0, 0.5, 0.5)
    assert timing.overruns == 1 and len(timing.arrivals) == WINDOW
    timing.clear()
    assert timing.figures(0.001) == {} and timing.overruns == 1
