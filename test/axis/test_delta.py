# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The Delta case: its controller by the polynomial that it makes, its axis by scipy, its published errors."""

import json

import numpy as np
import pytest
import scipy.signal

from research.axes import delta
from research.delta import main


@pytest.mark.parametrize("pole", [20.0, delta.FREQUENCY, 150.0])
def test_the_controller_places_four_equal_poles_and_inverts_the_axis(pole):
    g, p = delta.gains(pole), delta.NOMINAL
    k = p.gain * p.frequency**2
    open_loop = [1.0, 2.0 * p.damping * p.frequency, p.frequency**2, 0.0]
    closed = np.polyadd(
        np.polymul(open_loop, [1.0, 0.0]),
        k * np.array([g.second, g.derivative, g.proportional, g.integral]),
    )
    assert closed == pytest.approx(np.poly([-pole] * 4))
    assert k * np.array([g.jerk, g.acceleration, g.velocity, 0.0]) == pytest.approx(open_loop)


def test_the_step_of_the_axis_is_that_of_a_spool_on_a_straight_line():
    p = delta.NOMINAL
    k = p.gain * p.frequency**2
    t = np.arange(300) * delta.PERIOD
    spool = 5.0 * np.sin(9.0 * t)
    system = scipy.signal.lti([k], [1.0, 2.0 * p.damping * p.frequency, p.frequency**2, 0.0])
    _, expected, _ = scipy.signal.lsim(system, spool, t, interp=True)
    axis, x, found = delta.discrete(p), np.zeros(3), []
    for begin, end in zip(spool, np.append(spool[1:], 0.0), strict=True):
        found.append(x[0])
        x = axis.a @ x + axis.begin * begin + axis.end * end
    assert np.max(np.abs(found - expected)) < 1e-9


@pytest.mark.campaign
def test_the_published_figures_come_out_and_a_servo_valve_loses_next_to_nothing():
    """About 0.002 mm with exact parameters, about 0.07 mm with all of them 10 % low."""
    alone = delta.published(delta.Case(delta.NONE))
    assert 0.001e-3 < alone.nominal < 0.006e-3
    assert alone.low == pytest.approx(0.07e-3, rel=0.05)
    servo = delta.published(delta.Case("servo"))
    assert servo.worst < 1.2 * alone.worst and servo.restless < 1e-6
    assert len(servo.corners) == 8 and servo.corners[0] == servo.low


@pytest.mark.campaign
def test_with_dcarc_the_slow_valve_is_ten_times_nearer_than_as_delivered(tmp_path, capfd):
    assert main(["--json", str(tmp_path / "d.json")]) == 0
    found = json.loads((tmp_path / "d.json").read_text())["valves"]
    worst = {name: max(results["own"]["corners"]) for name, results in found.items()}
    assert worst["servo"] < worst["dcarc"] < worst["pid"] < worst["open_loop"]
    assert worst["dcarc"] < 0.1 * worst["open_loop"]
