"""docs/examples: a serial card's driver on a pseudo-terminal, an upper level, parameters without `ros2`."""

import importlib.util
import math
import os
import pty
import select
import signal
import subprocess
import sys
import time
import tty
from contextlib import contextmanager
from pathlib import Path

import pytest
from bench import LIMIT, controller, get_double, spin_until
from std_msgs.msg import Float64

from valve_control.parameter import defaults
from valve_control.parameters import build
from valve_control.parameters.table import VALVE
from valve_control.plant import valve

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


driver = example("valve_driver")


class Card:
    """The other end of the line: a simulated valve, sampled one frame at a time."""

    def __init__(self):
        self.line, self.slave = pty.openpty()
        tty.setraw(self.line)
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)
        self.p = build.valve_params(defaults(VALVE))
        self.s = valve.initial(self.p)
        self.counter = 0
        self.data = b""

    def send(self, volts):
        frame = driver.FRAME.pack(driver.FROM_CARD, self.counter, round(volts / 10.0 * driver.FULL_SCALE), 0)
        os.write(self.line, frame[:-1] + bytes([sum(frame[:-1]) % 256]))
        self.counter = (self.counter + 1) % 256

    def voltage(self, limit=LIMIT):
        """The next voltage that the driver sends [V]; None if none comes within ``limit`` [s]."""
        end = time.monotonic() + limit
        while len(self.data) < driver.FRAME.size:
            if not select.select([self.line], [], [], max(0.0, end - time.monotonic()))[0]:
                return None
            self.data += os.read(self.line, driver.FRAME.size - len(self.data))
        head, _, counts, total = driver.FRAME.unpack(self.data)
        assert head == driver.TO_CARD and total == sum(self.data[:-1]) % 256
        self.data = b""
        return counts * 10.0 / driver.FULL_SCALE

    def drain(self):
        while self.voltage(0.0) is not None:
            pass

    def sample(self):
        """One sample of the valve, answered."""
        reading = valve.read(self.p, self.s, 0.0)
        self.send(reading)
        voltage = self.voltage()
        assert voltage is not None
        self.s = valve.step(self.p, self.s, voltage)
        return reading, voltage


@contextmanager
def running(card, *settings):
    words = [word for s in (f"port:={card.port}", *settings) for word in ("-p", s)]
    child = subprocess.Popen(
        [sys.executable, str(EXAMPLES / "valve_driver.py"), "--ros-args", *words],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def test_driver_closes_the_loop_and_goes_to_zero(ros, tmp_path):
    card = Card()
    command = ros.create_publisher(Float64, "spool_command", 10)
    # A watchdog that waits for this bench, which is slower than a clock.
    with controller(tmp_path, "-p", "controller:=arc") as law, running(card, "voltage_timeout:=1.0") as node:
        spin_until(
            ros,
            lambda: (
                ros.count_publishers("spool_position") == 1
                and ros.count_publishers("valve_voltage") == 1
                and ros.count_subscribers("valve_voltage") == 1
                and command.get_subscription_count() == 1
            ),
            "driver and controller",
        )
        # Until a voltage other than the watchdog's shows that both directions carry.
        end = time.monotonic() + LIMIT
        voltage = 0.0
        while not voltage:
            assert time.monotonic() < end, "no voltage on the line"
            card.drain()
            command.publish(Float64(data=0.5))
            card.send(0.0)
            voltage = card.voltage(0.2)
        while card.voltage(0.5):
            pass
        readings = []
        for k in range(400):
            command.publish(Float64(data=math.sin(2.0 * math.pi * 0.001 * k)))
            reading, voltage = card.sample()
            readings.append(reading)
        assert max(readings) > 0.8, "the spool follows the command through the line"
        # Three frames are lost on the line: the controller answers each of them, and goes on.
        card.counter = (card.counter + 3) % 256
        card.send(readings[-1])
        assert all(card.voltage() is not None for _ in range(4))
        law.send_signal(signal.SIGTERM)
        law.wait(LIMIT)
        while card.voltage() != 0.0:
            pass
        node.send_signal(signal.SIGINT)
        assert node.wait(LIMIT) == 0, node.stderr.read()


def test_frames_are_found_in_noise():
    card = Card()
    port = driver.Card(card.port, 115200)
    os.write(card.line, bytes([driver.FROM_CARD, 1, 2]))  # the end of a frame is missing
    card.counter = 255
    card.send(5.0)
    card.send(-5.0)
    found = port.readings()
    assert [next(found), next(found)] == [(255, 16384), (0, -16384)]
    port.close()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["port:=/dev/no_such_port"], "no_such_port"),
        (["amplifier.limit:=20.0"], "scales are wrong"),
    ],
)
def test_driver_refuses_what_cannot_work(settings, words):
    card = Card()
    with running(card, *settings) as node:
        _, said = node.communicate(timeout=LIMIT)
    assert node.returncode == 2 and words in said and "Traceback" not in said


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
