# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Node valve_driver as a process: a serial card's twin on one side, the real controller on the other."""

import math
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
import rclpy
from bench import LIMIT, controller, process, set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from std_msgs.msg import Float64
from test_lifecycle import change

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "..", "drivers"))
from examples import serial_card

STEP = 10.0 / 32767  # V
WATCHDOG = 0.3  # s


@pytest.fixture
def card():
    made = serial_card.Card(friction__coulomb=0.3)
    made.counter = 65500  # passes from 65,535 to 0 in every test
    yield made
    made.close()


class Told:
    """What the driver publishes."""

    def __init__(self, node):
        self.node = node
        self.readings = []
        self.status = None
        self.seen = set()  # conditions
        node.create_subscription(Float64, "spool_position", lambda m: self.readings.append(m.data), 1000)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message):
        if message.status[0].name == "valve_driver":
            self.status = message.status[0]
            self.seen.update(self.values["conditions"].split(", "))

    @property
    def values(self):
        return {pair.key: pair.value for pair in self.status.values} if self.status else {}


@contextmanager
def driver(tmp_path, card, *settings):
    words = [word for s in (f"serial.port:={card.port}", *settings) for word in ("-p", s)]
    with process("valve_driver", words, tmp_path / "d.log") as child:
        yield child


def run(node, card, condition, what, limit=LIMIT):
    """Let the card sample by the clock until ``condition`` holds."""
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, f"{what} not within {limit} s"
        card.receive(time.monotonic())
        card.move()
        card.send(time.monotonic())
        rclpy.spin_once(node, timeout_sec=0.001)


@contextmanager
def loop(ros, tmp_path, card, *settings):
    """Driver and controller around the card, at work; the controller's process and what is told."""
    command = ros.create_publisher(Float64, "spool_command", 10)
    told = Told(ros)
    with (
        controller(tmp_path, "-p", "controller:=arc") as law,
        driver(tmp_path, card, f"watchdog:={WATCHDOG}", *settings) as node,
    ):

        def closed():
            command.publish(Float64(data=1.0))
            return abs(card.voltage) > 0.1

        run(ros, card, closed, "voltage at the card")
        yield law, node, told


@pytest.mark.alone
def test_the_loop_closes_and_a_killed_controller_leaves_zero_volts(ros, tmp_path, card):
    with loop(ros, tmp_path, card) as (law, node, told):
        assert not any(map(math.isnan, told.readings))
        os.kill(law.pid, signal.SIGKILL)
        run(ros, card, lambda: card.voltage == 0.0, "0 V", limit=WATCHDOG + 2.0)
        assert card._asked  # the driver lives, and gives the 0 V
        run(ros, card, lambda: "no_voltage" in told.seen, "condition")
        assert told.status.level == b"\x02" and told.values["voltage_timeouts"] == "1"
        os.kill(node.pid, signal.SIGKILL)
        run(ros, card, lambda: not card._asked, "the card's own watchdog")


def test_each_reading_is_answered_and_the_law_moves_the_spool(ros, tmp_path, card):
    with loop(ros, tmp_path, card, "watchdog:=5.0") as (_, node, told):
        voltages = []
        ros.create_subscription(Float64, "valve_voltage", lambda m: voltages.append(m.data), 100)
        run(ros, card, lambda: voltages, "voltage")
        count = -1
        while len(voltages) != count:  # until all that was under way has arrived
            count = len(voltages)
            for _ in range(10):
                rclpy.spin_once(ros, timeout_sec=0.02)
        for _ in range(300):
            count = len(voltages)
            reading = card.send(time.monotonic())
            spin_until(ros, lambda n=count: len(voltages) > n, "voltage")
            spin_until(
                ros,
                lambda: (
                    card.receive(time.monotonic()) or card.voltage == pytest.approx(voltages[-1], abs=STEP)
                ),
                "frame",
            )
            card.move()
        assert abs(reading - 1.0) < 0.2
        node.send_signal(signal.SIGTERM)
        assert node.wait(LIMIT) == 0
        card.receive(time.monotonic())
        assert card.voltage == 0.0 and not card._asked


def test_the_output_follows_the_state_and_an_open_device_keeps_its_scales(ros, tmp_path, card):
    told = Told(ros)
    voltage = ros.create_publisher(Float64, "valve_voltage", 10)

    def driven(value):
        def reached():
            voltage.publish(Float64(data=value))
            return card.voltage == pytest.approx(max(-10.0, min(10.0, value)), abs=STEP)

        return reached

    with driver(tmp_path, card):
        run(ros, card, driven(3.0), "3 V")
        run(ros, card, driven(70.0), "10 V")
        refused = set_parameters(ros, "valve_driver", position__scale="%")
        assert not refused.successful and "position.scale of an open device" in refused.reason
        refused = set_parameters(ros, "valve_driver", voltage__low=0.0, voltage__high=0.0)
        assert not refused.successful and "voltage.low is 0 V; it must be below" in refused.reason
        assert set_parameters(ros, "valve_driver", voltage__high=4.0).successful
        run(ros, card, driven(3.0), "3 V")
        voltage.publish(Float64(data=math.nan))
        run(ros, card, lambda: card.voltage == 0.0, "0 V for NaN")
        run(ros, card, lambda: "voltage_not_finite" in told.seen, "condition")
        assert change(ros, "valve_driver", Transition.TRANSITION_DEACTIVATE)
        run(ros, card, lambda: not card._asked, "output off")
        voltage.publish(Float64(data=3.0))
        run(ros, card, lambda: told.status.message == "inactive", "the state")
        assert not card._asked and card.voltage == 0.0
        assert change(ros, "valve_driver", Transition.TRANSITION_ACTIVATE)
        run(ros, card, driven(3.0), "3 V again")


def test_the_dry_run_tells_rate_noise_and_losses_and_writes_nothing(ros):
    card = serial_card.Card(lvdt__noise=0.01)
    child = subprocess.Popen(
        [sys.executable, "-m", "valve_control.nodes.valve_driver", "--check", "--ros-args",
         "-p", f"serial.port:={card.port}", "-p", "position.scale:='*2+1'"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    sent = 0
    while child.poll() is None:
        card.receive(time.monotonic())
        card.send(time.monotonic())
        sent += 1
        if sent % 100 == 0:
            card.counter += 1
        time.sleep(0.001)
    told = dict(line.split(maxsplit=1) for line in child.stdout.read().splitlines())
    assert child.returncode == 0 and card.frames == 0
    assert told["rate"].split()[1] == "Hz;" and int(told["readings"].split()[-2]) >= 1
    assert float(told["noise"].split()[0]) == pytest.approx(20.0, rel=0.2)
    assert float(told["position"].split()[0]) == pytest.approx(1.0, abs=0.01)
    card.close()
