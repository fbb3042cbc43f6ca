# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""docs/examples: an upper level; parameters, services and topics without `ros2`."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bench import LIMIT, controller, get_double, spin_until
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, MultiArrayLayout

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


def test_parameters_and_services_without_the_ros2_command(ros, tmp_path):
    def start(script, *words):
        return subprocess.Popen(
            [sys.executable, str(EXAMPLES / script), *words],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    def ended(child):
        out, _ = child.communicate(timeout=60)
        return child.returncode, out

    def put(*settings):
        return ended(start("set_parameters.py", *settings))

    def call(*words):
        return ended(start("call_service.py", *words))

    # Both are waited for, for some seconds.
    nodeless = start("set_parameters.py", "/nobody", "arc.k1=150.0")
    serviceless = start("call_service.py", "/nobody/reset")
    with controller(tmp_path):
        assert put("/controller", "arc.k1=150.0") == (0, "set\n")
        assert get_double(ros, "arc.k1") == 150.0
        status, out = put("/controller", "arc.k1=-1.0")
        assert status == 1 and "arc.k1 out of range" in out
        status, out = put("/controller", "arc.k1")
        assert status == 2 and out.startswith("write: set_parameters.py NODE NAME=VALUE")
        assert call("/controller/change_state", "deactivate")[0] == 0
        assert "'inactive'" in call("/controller/get_state")[1]
        status, out = call("/controller/change_state", "deactivate")
        assert status == 1 and "success=False" in out
        status, out = call("/controller/reset")
        assert status == 0 and "estimates and filters are at their start" in out
        status, out = call("/controller/set_parameters")
        assert status == 2 and "is a rcl_interfaces/srv/SetParameters; this script calls" in out
        log = (tmp_path / "c.log").read_text()
        assert "[controller]: off → safe (lvdt_missing): no LVDT reading yet" in log
    status, out = ended(nodeless)
    assert status == 2 and "no node /nobody" in out
    assert ended(serviceless) == (2, "there is no service /nobody/reset\n")


@pytest.mark.parametrize("script", ["echo.py", "call_service.py"])
def test_the_usage_is_printed(script):
    words = [sys.executable, str(EXAMPLES / script), "--help"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.startswith(f"usage: {script} ")


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
    child = subprocess.Popen([sys.executable, str(EXAMPLES / "upper_level.py")])
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
        diagnostics, unanswered = ros.create_publisher(DiagnosticArray, "/diagnostics", 10), []
        safe = DiagnosticStatus(level=DiagnosticStatus.ERROR, name="controller")

        def silent():
            diagnostics.publish(DiagnosticArray(status=[safe]))
            unanswered.append(not answered())
            commands.clear()
            return len(unanswered) > 10 and all(unanswered[-10:])

        spin_until(ros, silent, "silence in `safe`")
        child.send_signal(signal.SIGINT)
        assert child.wait(LIMIT) == 0
    finally:
        child.kill()
        child.wait()
