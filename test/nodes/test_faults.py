"""The whole fault campaign, as `make faults` runs it."""

import json
import math
import os
import subprocess
import sys

from valve_control.nodes.faults import CONTROLLERS, FAULTS


def test_each_fault_on_each_controller(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "valve_control.nodes.faults", "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=480,
        env={**os.environ, "ROS_DOMAIN_ID": "101"},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    entries = json.loads((tmp_path / "faults.json").read_text())
    expected = {(fault.name, controller) for fault in FAULTS for controller in fault.controllers}
    assert {(e["fault"], e["controller"]) for e in entries} == expected
    assert {e["controller"] for e in entries} == set(CONTROLLERS)
    for entry in entries:
        assert entry["recovered"] and entry["reaction_s"] <= entry["limit_s"], entry
        assert math.isfinite(entry["max_abs_voltage"]) and entry["max_abs_voltage"] <= 10.0
