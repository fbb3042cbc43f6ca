# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Hopsan's validation models "Position Servo" and "Hydraulic43ValveTest", rebuilt from their parameters."""

import math

import numpy as np
import pytest

from research.axes import hopsan
from valve_control.axis import axis
from valve_control.axis.axis_parameters import AXIS, axis_params
from valve_control.parameter import defaults

# 12 of the 2048 rows of "Position Servo.hvd" (github.com/Hopsan/hopsan, Models/Example Models Validations, of
# commit 36282b077, 2015-09-02): those in which the relief column changes most, of 24 spans of time.
QUOTED = np.array(
    [
        [0.0044, 0.000136555, 0.2, 0.00114447, 1.62465e-06],
        [0.0747, 0.290403, 0.2, -0.00198191, 1.50492e-06],
        [0.1553, 0.219476, 0.2, -0.000460961, 1.60241e-06],
        [0.2272, 0.195792, 0.2, 0.000220487, 1.63326e-06],
        [0.2697, 0.195009, 0.2, 0.000203574, 1.65037e-06],
        [0.6038, 0.195813, 0.2, 0.000172389, 1.66721e-06],
        [1.0039, 0.19089, 0.7, 0.00172685, 2.05242e-06],
        [1.0904, 0.762975, 0.7, 0.000778517, 1.08217e-06],
        [1.1607, 0.641913, 0.7, 0.00136083, 1.45122e-06],
        [1.2003, 0.725475, 0.7, -0.00062582, 1.50044e-06],
        [1.2882, 0.711503, 0.7, 9.18696e-05, 1.69941e-06],
        [2.3845, 0.707047, 0.7, -0.00019963, 1.6642e-06],
    ]
)  # s, m, m, m, m³/s/√Pa
RANGES = {"position": 0.811, "step": 0.5, "valve": 0.0127, "relief": 3.2e-6}  # of the whole columns


def test_by_hopsans_method_all_four_columns_of_its_reference_come_out():
    """Its own tolerance is 0.01; what is left is the sixth digit of the print."""
    times, mine = hopsan.by_lines()
    for i, name in enumerate(hopsan.NAMES, 1):
        found = np.interp(QUOTED[:, 0], times, mine[name])
        assert np.max(np.abs(found - QUOTED[:, i])) < 1e-5 * RANGES[name], name


@pytest.mark.campaign
def test_with_smaller_steps_hopsans_method_comes_to_ours():
    """Lines of 10 µs instead of 100 against our step: overshoot, cavitation and limit cycle, no delay.

    At the step of the goal the supply collapses. From there on the relief valve shows that both methods
    have models of cavitation of their own.
    """
    times, mine = hopsan.position_servo(("position.delay=0.0",))
    lines, columns = hopsan.by_lines(1e-5)
    rows = np.column_stack([lines, *(columns[name] for name in hopsan.NAMES)])[::10]
    rows = rows[np.abs(rows[:, 0] - 1.0) > 2e-4]  # the goal, between two samples
    found = hopsan.deviations(times, mine, rows)
    assert np.max(found["position"]) < 0.01 and np.max(found["valve"]) < 0.01 and np.max(found["step"]) == 0.0
    assert np.max(found["relief"][rows[:, 0] < 1.0]) < 0.01
    assert np.mean(found["relief"] > 0.01) < 0.01


# 8 of the 1000 rows of "Hydraulic43ValveTest.hvd" (Models/Component Test Validations, ba4f449dd, 2014-07-11).
QUOTED_FLOWS = np.array(
    [
        [0.1, -0.0028444, 0.00285873, -0.00285873, 0.0028444],
        [0.3, -0.00158859, 0.0015966, -0.0015966, 0.00158859],
        [0.44, -0.00070953, 0.000713104, -0.000713104, 0.00070953],
        [0.48, -0.000287981, 0.000291144, -0.000631066, 0.000627903],
        [0.52, 0.000215606, -0.000212443, -0.000631066, 0.000627903],
        [0.56, 0.00067524, -0.000671856, -0.00067524, 0.000671856],
        [0.7, 0.00155873, -0.00155092, -0.00155873, 0.00155092],
        [0.9, 0.00282086, -0.00280672, -0.00282086, 0.00280672],
    ]
)  # s, m³/s into a, b, supply and tank


def flows_of_a_ramp(t):
    """Underlapped spool (0.1 mm of 10 mm), ramp from -1 to 1 mm in 1 s behind a lag of 1000 rad/s twice."""
    values = {**defaults(AXIS), "spool.overlap": [-0.01] * 4, "spool.flow_pressure": 70e5}
    values["spool.laminar_pressure"] = 1000.0
    values["spool.flow"] = 0.67 * math.pi * 0.01 * 0.0101 * math.sqrt(2.0 * 70e5 / 890.0)
    p = axis_params(values)
    at = axis.initial(p, 0.25, 100e5, 100e5, 200e5)
    w = 1000.0
    ramp = -0.001 + 0.002 * (t - 2.0 / w + np.exp(-w * t) * (2.0 / w + t))
    q = [axis.flows(p, at, axis.Pressures(100e5, 100e5, 200e5), x / 0.01) for x in ramp]
    return np.array([(f.pa - f.at, f.pb - f.bt, -f.pa - f.pb, f.at + f.bt) for f in q])


def test_the_flows_of_the_four_edges_are_those_of_hopsans_valve():
    found = flows_of_a_ramp(QUOTED_FLOWS[:, 0])
    ranges = np.array([0.00692, 0.0069, 0.00284, 0.00284])  # of the whole columns
    assert np.all(np.abs(found - QUOTED_FLOWS[:, 1:]) < 0.01 * ranges)
