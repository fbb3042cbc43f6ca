# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""docs/examples: an upper level, and parameters without `ros2`."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bench import LIMIT, controller, get_double, spin_until
from std_msgs.msg import Float64

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


def test_parameters_are_set_without_the_ros2_command(ros, tmp_path):
    def put(*settings):
        return subprocess.run(
            [sys.executable, str(EXAMPLES / "set_parameters.py"), *settings],
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip

    with controller(tmp_path):
        done = put("/controller", "arc.k1=150.0")
        assert (done.returncode, done.stdout) == (0, "set\n"), done.stderr
        assert get_double(ros, "arc.k1") == 150.0
        done = put("/controller", "arc.k1=-1.0")
        assert done.returncode == 1 and "arc.k1 out of range" in done.stdout
    done = put("/nobody", "arc.k1=150.0")
    assert done.returncode == 2 and "no node /nobody" in done.stderr
    for words in ((), ("/controller",), ("/controller", "arc.k1")):
        done = put(*words)
        assert done.returncode == 2 and done.stderr.startswith("write: set_parameters.py NODE NAME=VALUE")


def test_upper_level_answers_each_reading(ros):
    commands = []
    ros.create_subscription(Float64, "spool_command", lambda m: commands.append(m.data), 10)
    lvdt = ros.create_publisher(Float64, "spool_position", 10)
    child = subprocess.Popen([sys.executable, str(EXAMPLES / "axis_controller.py")])
    try:
        spin_until(
            ros,
            lambda: lvdt.get_subscription_count() == 1 and ros.count_publishers("spool_command") == 1,
            "upper level",
        )

        def answered():
            lvdt.publish(Float64(data=2.0))
            return bool(commands)

        spin_until(ros, answered, "command")
        assert commands[0] == pytest.approx(0.6)
        child.send_signal(signal.SIGINT)
        assert child.wait(LIMIT) == 0
    finally:
        child.kill()
        child.wait()
