# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Controller with a device: reading, law and voltage in one process, the topics afterwards."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from bench import LIMIT, set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "..", "drivers"))
from examples import serial_card

from valve_control.control.parameters import build
from valve_control.control.parameters.drivers import SIMULATED
from valve_control.control.simulation import offline
from valve_control.nodes.harness.lockstep import CONFIG
from valve_control.nodes.harness.processes import Listener, node_arguments, node_values, process

STEP = 10.0 / 32767  # V


@pytest.mark.parametrize("law", ["arc", pytest.param("dcarc", marks=pytest.mark.campaign)])
def test_the_bits_are_those_of_offline_and_of_the_topics_in_lockstep(ros, tmp_path, law):
    settings = {
        "controller": {"controller": law, "lockstep": True, "lvdt.frozen_samples": 0, "state_decimation": 0},
        "command_source": {"trigger": "lockstep", "listeners": 1, "duration": 2.0},
    }
    plant = node_values("valve_simulator", CONFIG, {})
    command = build.commands(node_values("command_source", CONFIG, settings["command_source"]))
    twin = offline.simulate(node_values("controller", CONFIG, settings["controller"]), plant, command)
    own = {p.name: plant[p.name.removeprefix("simulated.")] for p in SIMULATED if p.name != "simulated.paced"}
    words = ["-p", "driver:=simulated", "-p", "simulated.paced:=false"]
    for name, value in own.items():
        words += ["-p", f"{name}:={build.as_text(value)}"]
    listener = Listener("listener", ("valve_voltage", "spool_position"))
    logs = tmp_path / "c.log", tmp_path / "s.log"
    with process("controller", node_arguments("controller", CONFIG, settings["controller"]) + words, logs[0]):
        spin_until(ros, lambda: ros.count_publishers("spool_position") == 1, "controller")
        source = node_arguments("command_source", CONFIG, settings["command_source"])
        with process("command_source", source, logs[1]):
            end = time.monotonic() + 1.0 * LIMIT
            heard = listener.sequence["valve_voltage"]
            while not heard or heard[-1] < len(command):
                assert time.monotonic() < end, (heard[-1:], logs[0].read_text(), logs[1].read_text())
                rclpy.spin_once(ros, timeout_sec=0.02)
                listener.fetch()
    for topic, expected in (("valve_voltage", twin.voltage), ("spool_position", twin.measurement)):
        numbers = np.array(listener.sequence[topic]) - 1
        inside = numbers < len(command)
        assert np.count_nonzero(inside) >= 0.9 * len(command)
        assert np.array_equal(listener.arrays(topic)[0][inside], expected[numbers[inside]])
    listener.destroy_node()


def test_a_card_is_controlled_beside_it_and_its_faults_are_told(ros, tmp_path):
    card = serial_card.Card(friction__coulomb=0.3)
    statuses, readings = [], []
    command = ros.create_publisher(Float64, "spool_command", 10)
    ros.create_subscription(DiagnosticArray, "/diagnostics", lambda m: statuses.append(m.status[0]), 100)
    ros.create_subscription(Float64, "spool_position", lambda m: readings.append(m.data), 100)
    words = [
        "driver:=serial",
        f"serial.port:={card.port}",
        "lvdt.period_limit:=1000.0",
        "lvdt.hold_samples:=500",
    ]
    arguments = [word for text in words for word in ("-p", text)]

    def run(condition, what, limit=LIMIT):
        end = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < end, f"{what}: {(tmp_path / 'c.log').read_text()}"
            card.receive(time.monotonic())
            card.move()
            card.send(time.monotonic())
            command.publish(Float64(data=1.0))
            rclpy.spin_once(ros, timeout_sec=0.001)

    with process("controller", arguments, tmp_path / "c.log") as child:
        run(lambda: readings and abs(readings[-1] - 1.0) < 0.2, "the spool at its command")
        assert card._asked
        refused = set_parameters(ros, serial__baud=9600)
        assert not refused.successful and "serial.baud of an open device" in refused.reason
        assert set_parameters(ros, arc__k1=150.0, voltage__high=4.0).successful
        card.sensor_sound = False

        def told(name):
            return any(name in v.value for s in statuses for v in s.values if v.key == "conditions")

        run(lambda: told("sensor_fault"), "condition")
        assert max(status.level for status in statuses) > b"\x00"
        os.kill(child.pid, signal.SIGKILL)
        run(lambda: not card._asked and card.voltage == 0.0, "0 V by the card's own watchdog")
    card.close()


def test_a_device_that_is_not_there_ends_it_with_a_sentence():
    done = subprocess.run(
        [sys.executable, "-m", "valve_control.nodes.controller", "--ros-args", "-p", "driver:=serial",
         "-p", "serial.port:=/dev/no_such_port"],
        capture_output=True, text=True, timeout=LIMIT,
    )  # fmt: skip
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith(
        "valve_control: the port /dev/no_such_port cannot be opened"
    )
