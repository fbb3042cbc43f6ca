# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Controller with a device: reading, law and voltage in one process, the topics afterwards."""

import os
import signal
import sys
import time
from contextlib import ExitStack, contextmanager, suppress

import numpy as np
import pytest
import rclpy
from bench import LIMIT, set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "..", "drivers"))
from examples import serial_card

from research.campaigns.lockstep import CONFIG
from research.campaigns.processes import Listener, node_arguments, node_values, process
from valve_control.control.drivers.device import Device, Side
from valve_control.control.drivers.driver import Reading, patience
from valve_control.control.drivers.scaling import Scale
from valve_control.control.parameters import build, drivers, ros_file
from valve_control.control.parameters.drivers import SIMULATED
from valve_control.control.simulation import offline
from valve_control.nodes.device_controller import DeviceController
from valve_control.nodes.valve_driver import ValveDriver

STEP = 10.0 / 32767  # V
SLOW = 0.02  # s, sample period of a field bus


def simulated(plant):
    """Words that make the simulated valve ``plant`` the device, one sample as soon as it is asked for."""
    own = {p.name: plant[p.name.removeprefix("simulated.")] for p in SIMULATED if p.name != "simulated.paced"}
    words = ["-p", "driver:=simulated", "-p", "simulated.paced:=false"]
    for name, value in own.items():
        words += ["-p", f"{name}:={ros_file.as_text(value)}"]
    return words


@pytest.mark.parametrize(
    ("law", "node", "spaces"),
    [
        ("arc", "controller", ("",)),
        ("arc", "manifold", ("/a", "/b")),
        pytest.param("dcarc", "controller", ("",), marks=pytest.mark.campaign),
    ],
)
def test_the_bits_are_those_of_offline_and_of_the_topics_in_lockstep(ros, tmp_path, law, node, spaces):
    settings = {
        "controller": {"controller": law, "lockstep": True, "lvdt.frozen_samples": 0, "state_decimation": 0},
        "command_source": {"trigger": "lockstep", "listeners": 2, "duration": 2.0},
    }
    plant = node_values("valve_simulator", CONFIG, {})
    command = build.commands(node_values("command_source", CONFIG, settings["command_source"]))
    twin = offline.simulate(node_values("controller", CONFIG, settings["controller"]), plant, command)
    words = node_arguments("controller", CONFIG, settings["controller"]) + simulated(plant)
    if node == "manifold":
        words += ["-p", f"valves:=[{','.join(space[1:] for space in spaces)}]"]
    expected = {"valve_voltage": twin.voltage, "spool_position": twin.measurement}
    listener = Listener("listener", [f"{space}/{topic}" for space in spaces for topic in expected])
    log = tmp_path / "c.log"
    with ExitStack() as stack:
        for space in spaces:
            source = node_arguments("command_source", CONFIG, settings["command_source"])
            named = [*source, "-r", f"__ns:={space}"] if space else source
            stack.enter_context(process("command_source", named, tmp_path / f"s{space[1:]}.log"))
            there = f"{space}/spool_command"
            spin_until(ros, lambda there=there: ros.count_publishers(there) == 1, there)
        stack.enter_context(process(node, words, log))
        for topic in listener.values:  # the run is short: it begins when all is heard
            spin_until(ros, lambda topic=topic: ros.count_publishers(topic) == 1, topic)
        for space in spaces:
            ros.create_subscription(Float64, f"{space}/spool_command", lambda m: None, 10)
        end = time.monotonic() + 1.0 * LIMIT
        heard = [listener.sequence[f"{space}/valve_voltage"] for space in spaces]
        while not all(numbers and numbers[-1] >= len(command) for numbers in heard):
            assert time.monotonic() < end, ([numbers[-1:] for numbers in heard], log.read_text())
            rclpy.spin_once(ros, timeout_sec=0.02)
            listener.fetch()
    for space in spaces:
        for name, values in expected.items():
            topic = f"{space}/{name}"
            numbers = np.array(listener.sequence[topic]) - 1
            inside = numbers < len(command)
            assert np.count_nonzero(inside) >= 0.9 * len(command)
            assert np.array_equal(listener.arrays(topic)[0][inside], values[numbers[inside]])
    listener.destroy_node()


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_card_is_controlled_beside_it_and_its_faults_are_told(ros, tmp_path, end):
    """At the end 0 V come from the node, or from the card's own watchdog."""
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
        refused = set_parameters(ros, lockstep=True, signal_decimation=10)
        assert not refused.successful and "signal_decimation must be 1 in lockstep" in refused.reason
        refused = set_parameters(ros, serial__baud=9600)
        assert not refused.successful and "serial.baud of an open device" in refused.reason
        assert set_parameters(ros, arc__k1=150.0, voltage__high=4.0).successful
        card.sensor_sound = False

        def told(name):
            return any(name in v.value for s in statuses for v in s.values if v.key == "conditions")

        run(lambda: told("sensor_fault"), "condition")
        assert max(status.level for status in statuses) > b"\x00"
        if end == signal.SIGTERM:
            card._rest = 7.0  # of the card's watchdog, so that only a frame of the node can give 0 V
        os.kill(child.pid, end)
        run(lambda: not card._asked and card.voltage == 0.0, "0 V")
    card.close()


class Bus:
    """Driver that waits for its device, as those of field buses do."""

    late = 0.0  # s, until it answers
    mute = False

    def open(self):
        pass

    def enable(self, on):
        pass

    def write(self, signal):
        self.signal = signal

    def read(self):
        time.sleep(patience(SLOW) if self.mute else self.late)
        return None if self.mute else Reading(0.5, 0)

    def close(self):
        pass

    def conditions(self):
        return ()


@contextmanager
def beside(monkeypatch, bus, *settings):
    """A controller of this process beside ``bus``; no reading may be missing, after 30 ms."""
    side = Side(Scale(1.0), -10.0, 10.0)
    monkeypatch.setattr(drivers, "device", lambda values: Device(bus, side, side, SLOW))
    slow = (
        f"sample_period:={SLOW}",
        "reshaping.natural_frequency:=50.0",
        "lvdt.hold_samples:=0",
        "lvdt.period_limit:=1000.0",
    )
    given = [word for text in (*slow, *settings) for word in ("-p", text)]
    valve = DeviceController(cli_args=["--ros-args", *given])
    try:
        yield valve
    finally:
        valve.finish()
        valve.destroy_node()


def test_a_wait_for_the_device_is_no_standstill_of_the_process(ros, monkeypatch):
    """Of a bus that falls silent the node hears after its wait of 100 ms, not after the 30 ms."""
    bus = Bus()
    with beside(monkeypatch, bus) as valve:
        valve.work()
        bus.late = 0.06
        valve.work()
        assert valve._supervisor.memory.samples == 2, "a reading that comes late is fresh"
        bus.mute, bus.late = True, 0.0
        valve.work()
        assert "lvdt_silent" in valve._supervisor.conditions and bus.signal == 0.0
        assert "stalled" not in valve._supervisor.conditions
    with beside(monkeypatch, Bus()) as valve:
        valve.work()
        valve._watch_at -= 1.0  # as if it had been put aside after its sample
        valve.work()
        assert "stalled" in valve._supervisor.conditions


def test_the_voltage_of_a_silence_is_on_the_topic_whatever_the_decimation(ros, monkeypatch):
    bus, heard = Bus(), []
    ros.create_subscription(Float64, "valve_voltage", lambda m: heard.append(m.data), 100)
    with beside(monkeypatch, bus, "signal_decimation:=10") as valve:
        spin_until(ros, lambda: valve._voltages.get_subscription_count() == 1, "the subscription")
        for _ in range(10):
            valve.work()
            valve.report()
        spin_until(ros, lambda: heard, "the tenth voltage")
        assert len(heard) == 1 and heard[0] != 0.0
        valve.work()  # so that the time of the wait above is no standstill
        valve.report()
        bus.mute = True
        valve.work()
        valve.report()
        spin_until(ros, lambda: len(heard) > 1, "the voltage of the silence")
        assert heard[1:] == [0.0]
        valve.trigger_deactivate()
        spin_until(ros, lambda: len(heard) > 2, "the last voltage")
        assert heard[2:] == [0.0]


def users(port):
    """How many open files of this process are ``port``."""
    found = 0
    for entry in os.listdir("/proc/self/fd"):
        with suppress(FileNotFoundError):  # the list itself has one
            found += os.readlink(f"/proc/self/fd/{entry}") == port
    return found


@pytest.mark.parametrize("active", [False, True])
@pytest.mark.parametrize("kind", [DeviceController, ValveDriver])
def test_cleaning_up_or_shutting_down_a_node_with_a_device_closes_the_port(
    ros, tmp_path, capfd, kind, active
):
    card, link = serial_card.Card(), tmp_path / "port"
    before = users(card.port)
    link.symlink_to(card.port)
    node = kind(cli_args=["--ros-args", "-p", "driver:=serial", "-p", f"serial.port:={link}"])
    try:
        node.trigger_deactivate()
        node.trigger_cleanup()
        for _ in range(2):
            link.unlink()
            node.trigger_configure()
            assert f"{link} cannot be opened" in capfd.readouterr().err
            link.symlink_to(card.port)
            node.trigger_configure()
            assert users(card.port) == before + 1
            if active:
                node.trigger_activate()
                node.work()
                node.trigger_deactivate()
            node.trigger_cleanup()
            assert users(card.port) == before
        node.trigger_configure()
        if active:
            node.trigger_activate()
            node.work()
        assert users(card.port) == before + 1
        node.trigger_shutdown()
        assert users(card.port) == before
        card.receive(time.monotonic())
        assert not card._asked
        node.work()
        node.report()
        node.finish()
    finally:
        node.destroy_node()
        card.close()


@pytest.mark.alone
def test_a_silent_card_of_a_manifold_does_not_hold_up_the_other(ros, tmp_path):
    """Two cards on two lines; one falls silent for 1 s, in which the other must not miss a frame."""
    cards = [serial_card.Card(), serial_card.Card()]
    voltages = {space: [] for space in ("a", "b")}
    for space, heard in voltages.items():
        ros.create_subscription(
            Float64, f"/{space}/valve_voltage", lambda m, heard=heard: heard.append(m.data), 100
        )
    words = ["-p", "valves:=[a,b]", "-p", "driver:=serial", "-p", "lvdt.period_limit:=1000.0"]
    ports = {f"/{s}/controller": {"serial.port": card.port} for s, card in zip(voltages, cards, strict=True)}
    (tmp_path / "ports.yaml").write_text(ros_file.as_yaml(ports))
    words += ["--params-file", str(tmp_path / "ports.yaml")]

    def turn(*spoken):
        for card in spoken:
            card.receive(time.monotonic())
            card.move()
            card.send(time.monotonic())
        rclpy.spin_once(ros, timeout_sec=0.001)

    with process("manifold", words, tmp_path / "m.log"):
        end = time.monotonic() + LIMIT
        while not all(card._asked for card in cards):
            assert time.monotonic() < end, (tmp_path / "m.log").read_text()
            turn(*cards)
        begun, frames = cards[0].counter, cards[0].frames
        silence = time.monotonic() + 1.0
        while time.monotonic() < silence:
            turn(cards[0])
        sent = cards[0].counter - begun
        assert sent > 100 and cards[0].frames - frames >= 0.95 * sent and cards[0]._asked
        for _ in range(3):
            turn(*cards)
        spin_until(ros, lambda: turn(*cards) or cards[1]._asked, "the silent card again")
    for card in cards:
        card.close()
