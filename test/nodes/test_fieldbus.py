# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Node valve_driver on Modbus TCP and on CANopen, between its topics and a valve in another process."""

import signal
import sys
import time
from pathlib import Path

import pytest
import rclpy
from bench import LIMIT, process
from std_msgs.msg import Float64

sys.path.insert(0, str(Path(__file__).parents[1] / "drivers"))
from spool import device

PERIOD = 0.01  # s
MODBUS = (
    "driver:=modbus",
    "modbus.input:=3",
    "modbus.output:=5",
    "modbus.enable_coil:=7",
    "modbus.timeout:=0.5",
)
CANOPEN = ("driver:=canopen", "canopen.interface:=slcan", "canopen.node:=5", "canopen.adapter_pause:=0.0",
           "canopen.sdo_timeout:=1.0", "canopen.watchdog:=0.5", "canopen.heartbeat:=0.2")  # fmt: skip
KINDS = {
    # process of the device, its words, words of the node, name of its address, off, on at 2 V
    "modbus": ("valve_modbus", ("0", str(PERIOD)), MODBUS, "modbus.port", "0.0000 0", "1.9999 1"),
    "canopen": ("valve_408", ("5", "408", "", str(PERIOD)), CANOPEN, "canopen.channel",
                "INIT 0.0000 PRE-OPERATIONAL", "ACTIVE 2.0001 OPERATIONAL"),
}  # fmt: skip


def words(settings):
    return [word for setting in (*settings, f"sample_period:={PERIOD}") for word in ("-p", setting)]


def volts(valve):
    """What acts on the spool."""
    return next(float(word) for word in valve.order("state").split() if "." in word)


@pytest.mark.parametrize("kind", KINDS)
def test_voltage_and_reading_pass_and_the_end_is_off(ros, tmp_path, kind):
    module, started, settings, address, off, on = KINDS[kind]
    voltage = ros.create_publisher(Float64, "valve_voltage", 10)
    readings = []
    ros.create_subscription(Float64, "spool_position", lambda m: readings.append(m.data), 1000)

    def until(condition, what, give=None):
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, f"{what} not within {LIMIT} s"
            if give is not None:
                voltage.publish(Float64(data=give))
            rclpy.spin_once(ros, timeout_sec=PERIOD)

    with device(module, *started) as valve:
        arguments = words((*settings, f"{address}:={valve.address}"))
        with process("valve_driver", arguments, tmp_path / "d.log") as node:
            until(lambda: valve.order("state") == on, "2 V at the valve", 2.0)
            until(lambda: readings and readings[-1] > 1.6, "the reading of 2 V", 2.0)  # model (3): 0.83 V/V
            until(lambda: volts(valve) == 0.0, "0 V after silence")
            until(lambda: valve.order("state") == on, "2 V again", 2.0)
            node.send_signal(signal.SIGTERM)
            assert node.wait(LIMIT) == 0
        assert valve.order("state") == off
