"""Through real processes over DDS, sample by sample, bit for bit as offline."""

import json
import os
import subprocess
import sys


def test_60_s_of_motion_equal_offline_for_every_controller(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "valve_control.nodes.lockstep", "--out", str(tmp_path), "--duration", "60"],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "ROS_DOMAIN_ID": "101"},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    entries = json.loads((tmp_path / "lockstep.json").read_text())
    assert [e["controller"] for e in entries] == ["arc", "oarc", "pid", "compensator", "open_loop"]
    for entry in entries:
        assert entry["equal"] and entry["samples"] == 60000
        assert entry["voltage_at_end_V"] == entry["offline_voltage_at_end_V"]
        assert entry["times_real_time"] > 1.0
