# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""docs/examples: an upper level; parameters, services and topics without `ros2`."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bench import LIMIT, controller, get_double, spin_until
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, MultiArrayLayout

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


def test_parameters_are_set_without_the_ros2_command(ros, tmp_path):
    def put(*settings):
        return subprocess.Popen(
            [sys.executable, str(EXAMPLES / "set_parameters.py"), *settings],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def said(child):
        out, err = child.communicate(timeout=60)
        return child.returncode, out, err

    nobody = put("/nobody", "arc.k1=150.0")  # is waited for, for some seconds
    incomplete = put("/controller", "arc.k1")
    with controller(tmp_path):
        assert said(put("/controller", "arc.k1=150.0")) == (0, "set\n", "")
        assert get_double(ros, "arc.k1") == 150.0
        status, out, _ = said(put("/controller", "arc.k1=-1.0"))
        assert status == 1 and "arc.k1 out of range" in out
    status, _, err = said(incomplete)
    assert status == 2 and err.startswith("write: set_parameters.py NODE NAME=VALUE")
    status, _, err = said(nobody)
    assert status == 2 and "no node /nobody" in err


def test_services_are_called_without_the_ros2_command(tmp_path):
    def call(*words):
        done = subprocess.run(
            [sys.executable, str(EXAMPLES / "call_service.py"), *words],
            capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    with controller(tmp_path):
        assert call("/controller/change_state", "deactivate")[0] == 0
        status, out = call("/controller/get_state")
        assert status == 0 and "'inactive'" in out
        status, out = call("/controller/change_state", "deactivate")
        assert status == 1 and "success=False" in out
        status, out = call("/controller/reset")
        assert status == 0 and "estimates and filters are at their start" in out
        status, out = call("/controller/set_parameters")
        assert status == 2 and "is a rcl_interfaces/srv/SetParameters; this script calls" in out
    status, out = call("/nobody/reset")
    assert status == 2 and out == "there is no service /nobody/reset\n"


def test_topics_are_shown_without_the_ros2_command(ros, tmp_path):
    state = ros.create_publisher(Float64MultiArray, "/valve/state", 10)
    with (tmp_path / "log").open("w") as output:
        child = subprocess.Popen([sys.executable, str(EXAMPLES / "echo.py"), "/valve/state"], stdout=output)
    try:
        spin_until(ros, lambda: state.get_subscription_count() == 1, "subscription")
        layout = MultiArrayLayout(dim=[MultiArrayDimension(label=label) for label in ("z1", "a1")])

        def shown():
            state.publish(Float64MultiArray(layout=layout, data=[0.5, -20.0]))
            return (tmp_path / "log").read_text().startswith("z1: 0.5\na1: -20\n---\n")

        spin_until(ros, shown, "message")
        child.send_signal(signal.SIGINT)
        assert child.wait(LIMIT) == 0
    finally:
        child.kill()
        child.wait()


def test_a_number_is_published_without_the_ros2_command(ros):
    script = [sys.executable, str(EXAMPLES / "publish.py"), "/valve_voltage"]
    refused = subprocess.run([*script, "0.5", "--rate", "0"], capture_output=True, text=True, timeout=60)
    assert refused.returncode == 2
    assert refused.stderr.endswith("--rate is 0; it must be above 0 and at most 1000\n")
    voltages = []
    ros.create_subscription(Float64, "/valve_voltage", lambda m: voltages.append(m.data), 10)
    child = subprocess.Popen([*script, "-0.5", "--rate", "50"], stdout=subprocess.DEVNULL)
    try:
        spin_until(ros, lambda: len(voltages) >= 3, "voltages")
        assert set(voltages) == {-0.5}
        child.send_signal(signal.SIGINT)
        assert child.wait(LIMIT) == 0
    finally:
        child.kill()
        child.wait()


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
