# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Modbus TCP: the driver against pymodbus's server in another process, with a simulated valve behind it."""

import socketserver
import threading
import time
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool import device, until

from valve_control.control.drivers.driver import DriverError
from valve_control.control.drivers.modbus import KIND, PARAMETERS
from valve_control.parameter import defaults, updated

PERIOD = 0.005  # s
VALVE = {"modbus.input": 3, "modbus.output": 5, "modbus.enable_coil": 7, "modbus.timeout": 1.0}


def driver(io=None, **changes):
    named = {f"modbus.{name}": value for name, value in changes.items()}
    port = {"modbus.port": int(io.address)} if io else {}
    return KIND.make(updated(PARAMETERS, defaults(PARAMETERS), {**VALVE, **port, **named}), PERIOD, 0.0)


@pytest.fixture(scope="module")
def started():
    with device("valve_modbus", "0", str(PERIOD)) as process:
        yield process


@pytest.fixture
def io(started):
    started.order("reset")
    return started


def names(valve):
    return {c.name: c.level for c in valve.conditions()}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_spool_follows_the_voltage_and_goes_to_zero_at_the_end(io, sign):
    valve = driver(io)
    valve.open()
    assert valve.read() == (0.0, 0)
    valve.write(3.0)
    assert io.order("state") == "0.0000 0", "nothing is written before enable"
    valve.enable(True)
    valve.write(sign * 2.0)
    assert io.order("state") == f"{sign * 1.9999:.4f} 1"  # 6553 counts
    readings = [valve.read() for _ in range(100)]
    assert readings[-1].signal == pytest.approx(sign * 1.67, abs=0.05)  # model (3): 0.83 V/V
    valve.close()
    assert io.order("state") == "0.0000 0"


def test_requests_without_an_answer_are_lost_readings_then_a_lost_connection(io):
    valve = driver(io, timeout=0.2)
    valve.open()
    valve.read()
    io.order("silent")
    assert valve.read() is None and names(valve)["timeout"] == "degraded"
    io.order("none")
    found = until(valve.read, "an answer")
    assert found.lost >= 1
    io.order("silent")
    with pytest.raises(DriverError, match=r"has not answered 3 requests in a row"):
        [valve.read() for _ in range(3)]
    with pytest.raises(DriverError, match="closed the connection"):
        valve.read()
    valve.close()


def test_refused_requests_are_conditions_and_a_refused_voltage_switches_off(io):
    valve = driver(io)
    valve.open()
    valve.enable(True)
    valve.write(1.0)
    io.order("refuse_read 6")
    assert valve.read() is None and names(valve)["busy"] == "degraded"
    io.order("refuse_read 4")
    assert valve.read() is None and names(valve)["read_refused"] == "degraded"
    io.order("refuse_write 4")
    assert valve.read().lost >= 2 and "read_refused" not in names(valve)
    valve.write(2.0)
    assert names(valve)["write_refused"] == "safe"
    assert "holding register 5: exception 4 (device failure)" in str(valve.conditions())
    assert io.order("none").endswith(" 0"), "the coil is off"
    valve.write(2.0)
    assert io.order("state").endswith(" 0"), "it stays off until it is enabled anew"
    valve.enable(True)
    assert "write_refused" not in names(valve) and io.order("state") == "0.0000 1"
    valve.close()


def test_a_busy_device_is_asked_again_and_one_that_stays_busy_or_refuses_its_reading_is_told(io):
    valve = driver(io, timeout=0.2)
    valve.open()
    io.order("busy 2")
    valve.enable(True)
    assert io.order("state") == "0.0000 1" and names(valve) == {"busy": "degraded"}
    io.order("busy 99")
    with pytest.raises(DriverError, match="stays busy and does not accept holding register 5"):
        valve.enable(True)
    io.order("refuse_read 2")
    valve.close()
    with pytest.raises(DriverError, match=r"refuses input register 3: exception 2 \(no such address\)"):
        valve.open()


def test_a_device_that_answers_reads_and_no_writes_is_told(io):
    valve = driver(io, timeout=0.2)
    valve.open()
    io.order("silent")
    with pytest.raises(DriverError, match="does not answer to holding register 5"):
        valve.enable(True)
    valve.close()
    io.order("none")
    assert io.order("state") == "0.0000 0"
    silent = driver(io, timeout=0.2)
    io.order("silent")
    with pytest.raises(DriverError, match="is connected but does not answer within 0.2 s"):
        silent.open()
    silent.close()


def test_an_answer_in_slow_bytes_costs_one_request():
    """A byte each 40 ms. Its rest was taken for the next answers, until the device was opened anew."""
    slow = []

    class Handler(socketserver.BaseRequestHandler):
        def handle(self):
            while request := self.request.recv(12):
                answer = request[:4] + b"\0\5" + request[6:8] + b"\2\0\x64"
                if slow:
                    slow.clear()
                    for i in range(len(answer)):
                        time.sleep(0.04)
                        with suppress(OSError):
                            self.request.send(answer[i : i + 1])
                else:
                    self.request.send(answer)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        named = {"modbus.port": server.server_address[1], "modbus.counts": 1.0, "modbus.timeout": 0.1}
        made = KIND.make(updated(PARAMETERS, defaults(PARAMETERS), named), PERIOD, 0.0)
        made.open()
        slow.append(True)
        assert made.read() is None
        assert [made.read().signal for _ in range(5)] == [100.0] * 5
        made.close()
        server.shutdown()


def test_a_voltage_that_cannot_be_taken_back_is_told_and_tried_again(io):
    valve = driver(io, enable_coil=-1)
    valve.open()
    valve.enable(True)
    valve.write(2.0)
    io.order("refuse_write 4")
    with pytest.raises(DriverError, match=r"holding register 5: exception 4 .*the last voltage stays"):
        valve.write(3.0)
    valve.close()
    valve.open()
    with pytest.raises(DriverError, match="the last voltage stays"):
        valve.enable(False)
    assert io.order("none").startswith("1.9999")
    valve.close()
    assert io.order("state").startswith("0.0000")


def test_a_device_that_dies_is_told_and_opened_anew_when_it_is_back():
    with device("valve_modbus", "0", str(PERIOD)) as io:
        valve = driver(io)
        valve.open()
        assert valve.read()
    with pytest.raises(DriverError, match="closed the connection"):
        valve.read()
    valve.close()
    with pytest.raises(DriverError, match=r"no Modbus device answers at 127\.0\.0\.1:\d+ \(unit 1\);"):
        valve.open()
    with device("valve_modbus", io.address, str(PERIOD)):
        valve.open()
        assert valve.read() == (0.0, 0)
        valve.close()


@given(st.floats(-12.0, 12.0), st.booleans())
def test_counts_are_the_signal_within_half_a_count_and_its_range(signal, signed):
    valve = driver(signed=signed)
    register = valve._counts(signal)
    assert 0 <= register <= 0xFFFF
    counts = register - (register >> 15 << 16) if signed else register
    low, high = (-32768, 32767) if signed else (0, 65535)
    assert counts == pytest.approx(max(low, min(high, signal * 3276.7)), abs=0.5)
