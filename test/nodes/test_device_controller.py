# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Controller with a device: reading, law and voltage in one process, the topics afterwards."""

import os
import signal
import sys
import time
from contextlib import contextmanager, suppress

import pytest
import rclpy
from bench import LIMIT, set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "..", "drivers"))
from examples import serial_card

from research.campaigns.lockstep import CONFIG
from research.campaigns.processes import node_arguments, node_values, process
from valve_control.control.drivers.device import Device, Side
from valve_control.control.drivers.driver import Reading, patience
from valve_control.control.drivers.scaling import Scale
from valve_control.control.parameters import build, drivers, ros_file
from valve_control.control.parameters.drivers import SIMULATED
from valve_control.control.simulation import offline
from valve_control.nodes.adapter import encoded
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


@pytest.mark.parametrize("law", ["arc", "dcarc"])
def test_the_bits_are_those_of_offline(ros, law):
    """One command before each reading; without noise, since the reading before the start is dropped."""
    settings = {
        "controller": law, "lvdt.frozen_samples": 0, "lvdt.period_limit": 1000.0, "lvdt.hold_samples": 500,
    }  # fmt: skip
    plant = node_values("valve_simulator", CONFIG, {"lvdt.noise": 0.0})
    command = build.commands(node_values("command_source", CONFIG, {"duration": 2.0}))
    twin = offline.simulate(node_values("controller", CONFIG, {**settings, "lockstep": True}), plant, command)
    words = node_arguments("controller", CONFIG, settings) + simulated(plant)
    valve = DeviceController(cli_args=["--ros-args", *words])
    readings, voltages = [], []
    valve._send_position, valve._send_voltage = readings.append, voltages.append
    try:
        for value in command:
            valve._relay(float(value))
            valve.work()
            valve.report()
    finally:
        valve.finish()
        valve.destroy_node()
    assert readings == [encoded(value) for value in twin.measurement]
    assert voltages[: len(command)] == [encoded(value) for value in twin.voltage]


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
        valve._silent_at -= 1.0  # as if it had been put aside after its sample
        valve.work()
        assert "stalled" in valve._supervisor.conditions


def test_the_voltage_of_a_silence_and_the_last_one_are_on_the_topic(ros, monkeypatch):
    bus, heard = Bus(), []
    ros.create_subscription(Float64, "valve_voltage", lambda m: heard.append(m.data), 100)
    with beside(monkeypatch, bus) as valve:
        spin_until(ros, lambda: valve._voltages.get_subscription_count() == 1, "the subscription")
        valve.work()
        valve.report()
        spin_until(ros, lambda: heard, "the first voltage")
        assert len(heard) == 1
        valve.work()  # so that the time of the wait above is no standstill
        valve.report()
        bus.mute = True
        valve.work()
        valve.report()
        spin_until(ros, lambda: len(heard) > 2, "the voltage of the silence")
        assert heard[2:] == [0.0]
        valve.trigger_deactivate()
        spin_until(ros, lambda: len(heard) > 3, "the last voltage")
        assert heard[3:] == [0.0]


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
