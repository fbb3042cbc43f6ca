# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The Delta case: its controller by the polynomial that it makes, its axis by scipy, its published errors."""

import json

import pytest

from research.axes import delta
from research.delta import main


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
