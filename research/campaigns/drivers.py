# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Faults of devices and buses: a controller with its driver, and a simulated device in another process.

The devices are those of test/drivers: a card on a pseudo-terminal, a Modbus server on loopback, a CiA 408
valve behind an slcan adapter on a pseudo-terminal. A fault begins with the order to the device, or with the
signal that kills the controller; the output is the voltage that acts on the device's spool.
"""

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from std_msgs.msg import Float64

from research.campaigns.processes import process
from valve_control.nodes.adapter import EVERYTHING, SAMPLES, PolledSubscription, encoded

DEVICES = Path(__file__).parents[2] / "test" / "drivers"
COMMAND = 2.0  # V, held by a voltage of about as much: open loop
MOVED = 1.0  # V, of an output that is on
ALLOWANCE = 0.015  # s, as in the campaign of the laws
REPORT = 0.1 + ALLOWANCE  # s
WATCHDOG = 0.1  # s, of each device
TIMEOUT = 0.05  # s, of a request to the Modbus device
HEARTBEAT = 0.1  # s
LOST = 3  # readings
STAYS = 0.3  # s for which an output that stays on is watched
BACK = 10.0  # s
START = 30.0  # s
LOOK = 0.002  # s between two commands, and two looks at the output
TRIES = 3  # of a fault
KILL = "kill"  # the controller, with SIGKILL


class Kind(NamedTuple):
    """A kind of device: its program in test/drivers with its words, and the words of the controller."""

    program: str
    words: tuple[str, ...]
    period: float  # s
    hold: int  # missing readings that are bridged
    address: str  # parameter of its address
    settings: tuple[str, ...]


class Fault(NamedTuple):
    """A fault of a device, and what must follow."""

    driver: str
    name: str
    order: str  # to the device, or KILL
    condition: str  # that must be reported, "" if nobody is left to report it
    reported: float  # s within which
    off: float | None  # s within which the output is at 0 V; None: it stays on


KINDS = {
    "serial": Kind("valve_serial", ("0.001",), 0.001, 20, "serial.port", ()),
    "modbus": Kind(
        "valve_modbus",
        ("0", "0.005", str(WATCHDOG)),
        0.005,
        5,
        "modbus.port",
        ("modbus.input:=3", "modbus.output:=5", "modbus.enable_coil:=7", f"modbus.timeout:={TIMEOUT}"),
    ),
    "canopen": Kind(
        "valve_408",
        ("5", "408", "", "0.005"),
        0.005,
        5,
        "canopen.channel",
        ("canopen.interface:=slcan", "canopen.node:=5", "canopen.adapter_pause:=0.0",
         "canopen.sdo_timeout:=1.0", f"canopen.watchdog:={WATCHDOG}", f"canopen.heartbeat:={HEARTBEAT}"),
    ),
}  # fmt: skip


def silence(driver: str) -> float:
    """Time [s] of missing readings after which the controller gives 0 V, and the device has it."""
    return (KINDS[driver].hold + 2.5) * KINDS[driver].period + ALLOWANCE


BEATS = 2.5 * HEARTBEAT  # s without a heartbeat
CYCLE = 2.0 * KINDS["canopen"].period + ALLOWANCE  # s in which a command of the driver reaches the valve
FAULTS = (
    Fault("serial", "frames_lost", f"lose {LOST}", "readings_lost", REPORT, None),
    Fault("serial", "frames_damaged", f"damage {LOST}", "damaged_frames", REPORT, None),
    Fault("serial", "sensor_fault", "sensor 0", "sensor_fault", REPORT, silence("serial")),
    Fault("serial", "card_silent", "silent 1", "lvdt_silent", silence("serial") + REPORT, silence("serial")),
    Fault("serial", "killed", KILL, "", 0.0, WATCHDOG + ALLOWANCE),
    Fault("modbus", "device_silent", "silent", "timeout", TIMEOUT + REPORT, WATCHDOG + ALLOWANCE),
    Fault("modbus", "reading_refused", "refuse_read 4", "read_refused", REPORT, silence("modbus")),
    Fault("modbus", "voltage_refused", "refuse_voltage 4", "write_refused", REPORT,
          3.0 * KINDS["modbus"].period + ALLOWANCE),
    Fault("modbus", "killed", KILL, "", 0.0, WATCHDOG + ALLOWANCE),
    Fault("canopen", "pdo_lost", f"drop {LOST}", "pdo_lost", REPORT, None),
    Fault("canopen", "emergency", "emergency 3100", "emergency", REPORT, CYCLE),
    Fault("canopen", "node_reset", "reset", "node_reset", REPORT, CYCLE),
    Fault("canopen", "heartbeat_lost", "mute", "heartbeat_lost", BEATS + HEARTBEAT + REPORT,
          BEATS + HEARTBEAT + CYCLE),
    Fault("canopen", "node_silent", "bus_off 1", "bus_silent", BEATS + HEARTBEAT + REPORT,
          WATCHDOG + ALLOWANCE),
    Fault("canopen", "enable_input", "enable 0", "wrong_state", REPORT, CYCLE),
    Fault("canopen", "killed", KILL, "", 0.0, WATCHDOG + ALLOWANCE),
)  # fmt: skip


class Device:
    """A simulated device in another process."""

    def __init__(self, child: "subprocess.Popen[str]") -> None:
        self.child = child
        self.address = self._line()

    def _line(self) -> str:
        assert self.child.stdout is not None
        line = self.child.stdout.readline().strip()
        if not line:
            raise RuntimeError("a simulated device ended")
        return line

    def order(self, text: str) -> float:
        """Give an order; returns the voltage [V] at the amplifier afterwards."""
        assert self.child.stdin is not None
        self.child.stdin.write(f"{text}\n")
        return next(float(word) for word in self._line().split() if "." in word)


@contextmanager
def device(kind: Kind) -> Iterator[Device]:
    """Run a device of ``kind``."""
    child = subprocess.Popen(
        [sys.executable, str(DEVICES / f"{kind.program}.py"), *kind.words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
    )
    try:
        yield Device(child)
    finally:
        child.kill()
        child.wait()


class Upper(Node):  # type: ignore[misc]  # mypy does not see rclpy
    """The upper level of the controller; it keeps the stamps at which each condition was reported."""

    def __init__(self) -> None:
        super().__init__("upper_level")
        self.reported: list[tuple[float, list[str]]] = []  # s, names
        self._command = self.create_publisher(Float64, "spool_command", SAMPLES)
        self._diagnostics = PolledSubscription(self, DiagnosticArray, "/diagnostics", EVERYTHING)

    def go_on(self) -> None:
        """Send the command, and hear what was reported."""
        self._command.publish(encoded(COMMAND))
        for message, _ in self._diagnostics.take():
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            for status in message.status:
                values = {pair.key: pair.value for pair in status.values}
                if "conditions" in values:
                    self.reported.append((stamp, values["conditions"].split(", ")))

    def first(self, condition: str, start: float) -> float:
        """Time [s] at which ``condition`` was first reported after ``start``, inf if never."""
        return next((s for s, names in self.reported if s >= start and condition in names), math.inf)


def run_fault(fault: Fault, folder: Path) -> dict[str, Any]:
    """Inject ``fault`` until it passes, up to TRIES times, as the campaign of the laws does."""
    for repeated in range(TRIES):
        result = {**_judged(fault, folder), "repeated": repeated}
        if result["passed"]:
            break
    return result


def _judged(fault: Fault, folder: Path) -> dict[str, Any]:
    """Inject ``fault`` into a device and a controller of its own, and judge what follows."""
    kind = KINDS[fault.driver]
    log = folder / f"faults_{fault.driver}_{fault.name}.log"
    upper = Upper()
    try:
        with device(kind) as there:
            settings = (f"driver:={fault.driver}", f"{kind.address}:={there.address}", *kind.settings)
            settings += (
                "controller:=open_loop",
                f"sample_period:={kind.period}",
                f"lvdt.hold_samples:={kind.hold}",
            )
            with process("controller", [w for s in settings for w in ("-p", s)], log) as child:
                reaction, off = _measured(fault, there, child, upper)
    finally:
        upper.destroy_node()
    return {
        "fault": fault.name,
        "driver": fault.driver,
        "reported_s": round(reaction, 5) if math.isfinite(reaction) else None,
        "reported_limit_s": round(fault.reported, 5),
        "off_s": round(off, 5) if math.isfinite(off) else None,
        "off_limit_s": fault.off and round(fault.off, 5),
        "passed": bool(
            (reaction <= fault.reported or not fault.condition)
            and (off <= fault.off if fault.off is not None else math.isinf(off))
        ),
    }


def _measured(fault: Fault, there: Device, child: Any, upper: Upper) -> tuple[float, float]:
    """Times [s] to report and to 0 V, inf: never."""

    def until(condition: Callable[[], bool], what: str, limit: float) -> None:
        end = time.monotonic() + limit
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"{fault.driver} {fault.name}: no end of {what} within {limit:g} s")
            upper.go_on()
            time.sleep(LOOK)

    until(lambda: there.order("state") > MOVED, "the wait for the output", START)
    settled = time.monotonic() + 3.0 * WATCHDOG + BEATS
    until(lambda: time.monotonic() > settled, "the motion", START)
    start = time.time()
    if fault.order == KILL:
        child.kill()
    else:
        there.order(fault.order)
    off = math.inf
    limit = time.monotonic() + (STAYS if fault.off is None else BACK)

    def over() -> bool:
        nonlocal off
        if there.order("state") == 0.0:
            off = min(off, time.time() - start)
        told = not fault.condition or upper.first(fault.condition, start) < math.inf
        return time.monotonic() > limit or (told and fault.off is not None and off < math.inf)

    until(over, fault.name, 2.0 * BACK)
    return upper.first(fault.condition, start) - start if fault.condition else 0.0, off


def table(results: list[dict[str, Any]]) -> str:
    """The results as a table, one fault a line, times in ms."""

    def cell(time: float | None) -> str:
        return "-" if time is None else f"{1e3 * time:.1f}"

    lines = [f"{'fault of a device [ms]':32}{'reported':>10}{'limit':>8}{'0 V':>10}{'limit':>8}"]
    for r in results:
        reported = (None, None) if r["reported_limit_s"] == 0.0 else (r["reported_s"], r["reported_limit_s"])
        cells = [cell(value) for value in (*reported, r["off_s"], r["off_limit_s"])]
        row = f"{r['driver'] + ' ' + r['fault']:32}{cells[0]:>10}{cells[1]:>8}{cells[2]:>10}{cells[3]:>8}"
        lines.append(row + ("" if r["passed"] else "  FAILED"))
    return "\n".join(lines)
