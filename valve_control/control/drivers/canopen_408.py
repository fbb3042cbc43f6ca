# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Driver of a valve with CANopen and the device profile CiA 408, its spool controlled in open loop.

Set point (0x6300) and actual value (0x6301) are PDOs with control and status word. The driver sends SYNC at
an absolute clock; each SYNC makes one reading. Before ``enable`` the valve stays in pre-operational, and the
actual value is asked for by SDO.
"""

import math
import struct
import time
from typing import TYPE_CHECKING, Any

from valve_control.control.drivers import canopen_states as states
from valve_control.control.drivers.canopen_setup import configure, find
from valve_control.control.drivers.driver import (
    Condition,
    Driver,
    DriverError,
    Kind,
    Reading,
    missing,
    patience,
)
from valve_control.control.drivers.ticks import Lately, Ticks
from valve_control.parameter import Parameter, ParameterError, Values, number

if TYPE_CHECKING:
    from valve_control.control.drivers.can_bus import CanNode

NAME = "canopen"
SYNC = 0x80
OPERATIONAL, BOOTED = 5, 0  # in a heartbeat
POLL = 0.01  # s between two readings by SDO, at least
PATIENCE = 3  # unanswered requests in a row before the node counts as gone
GRACE = 0.5  # s for the way to ACTIVE
HEARTBEATS = 2.5  # periods without one after which it is lost
BEATS = 4  # heartbeats of this driver within the watchdog's time
OWN_STATE = bytes([OPERATIONAL])
FRAMES = 55 + 98 + 98  # bits of SYNC and both PDOs, stuffed at worst, with the spaces behind them
DATA = struct.Struct("<Hh")  # control word and set point; status word and actual value

PARAMETERS = (
    Parameter("canopen.interface", "socketcan", "", "interface of python-can: socketcan, slcan, pcan, ..."),
    Parameter("canopen.channel", "can0", "", "its channel: can0, /dev/ttyACM0, PCAN_USBBUS1, ..."),
    Parameter("canopen.bitrate", 500000, "bit/s", "bit rate; on socketcan `ip link` sets it, not this",
              low=10000, high=1000000),
    Parameter("canopen.node", 1, "-", "node id of the valve", low=1, high=127),
    Parameter("canopen.adapter_pause", 2.0, "s", "pause after opening an slcan adapter, as some start anew",
              low=0.0, high=10.0),
    Parameter("canopen.sdo_timeout", 0.1, "s", "longest wait for an answer of the object dictionary",
              low=0.01, high=2.0),
    Parameter("canopen.device_mode", 1, "-", "value for 0x6042: 1 set point from the bus, 0 left as it is",
              low=0, high=127),
    Parameter("canopen.control_mode", 1, "-",
              "value for 0x6043: 1 spool position in open loop, 2 in closed loop, 0 left as it is",
              low=0, high=127),
    Parameter("canopen.reference", 0, "-", "counts of 100 %; 0: as 0x6311:01 tells (16384 as a rule)",
              low=0, high=32767),
    Parameter("canopen.on_sync", True, "", "the set point acts at the next SYNC; false: when it arrives"),
    Parameter("canopen.watchdog", 0.1, "s", "silence after which the valve itself reports a fault "
              "(0x1400:05, else 0x1016); 0: it does not watch", low=0.0, high=60.0),
    Parameter("canopen.heartbeat", 0.1, "s", "period of the valve's heartbeat (0x1017); 0: none",
              low=0.0, high=60.0),
)  # fmt: skip


class Valve408:
    """One valve; signals are per cent of the reference value."""

    def __init__(self, values: Values, period: float, off: float) -> None:
        self._p: dict[str, Any] = {name.removeprefix(f"{NAME}."): value for name, value in values.items()}
        self._period = period
        self._wait = patience(period)
        self._off = off
        self._node: CanNode | None = None
        self._reference = 0
        self._running = False  # PDOs are exchanged
        self._on = False
        self._faults: dict[str, str] = {}  # that switched the output off
        self._unwatched = False
        self._consumed = 0  # node id of this driver, whose heartbeat the valve watches; 0: it does not
        self._beat_at = 0.0  # s, of the next heartbeat of this driver
        self._silent = 0  # unanswered requests in a row
        self._status = 0
        self._actual: int | None = None
        self._setpoint = 0  # counts
        self._sent = False  # in this cycle
        self._lost, self._lost_lately = 0, Lately()
        self._since = self._beat = 0.0  # s, of the last enable and the last heartbeat
        self._reached = False  # ACTIVE since the last enable
        self._resetting = 0  # cycles left to reset a fault

    def open(self) -> None:
        """Open the bus, find the valve and read its scaling; nothing is written to it. Raises DriverError."""
        try:
            from valve_control.control.drivers.can_bus import CanNode
        except ImportError:
            raise missing("canopen and python-can", NAME, NAME) from None
        p = self._p
        pause = {"sleep_after_open": p["adapter_pause"]} if p["interface"] == "slcan" else {}
        self._faults, self._running, self._on, self._silent = {}, False, False, 0
        node = self._node = CanNode(
            p["node"],
            p["sdo_timeout"],
            interface=p["interface"],
            channel=p["channel"],
            bitrate=p["bitrate"],
            **pause,
        )
        try:
            self._reference = find(node, p)
        except DriverError:
            self.close()
            raise
        node.on(0x180 + p["node"], self._on_actual)
        node.on_heartbeat(self._on_heartbeat)
        node.on_emergency(self._on_emergency)
        self._ticks = Ticks(max(POLL, self._period))

    # What comes from the valve

    def _on_actual(self, identifier: int, data: bytes, stamp: float) -> None:
        if len(data) >= DATA.size:
            self._status, self._actual = DATA.unpack_from(data)

    def _on_heartbeat(self, state: int) -> None:
        self._beat = time.monotonic()
        if not self._running:
            return
        if state == BOOTED:
            self._fail("node_reset", "the valve has started anew")
        elif state != OPERATIONAL and time.monotonic() > self._since + GRACE:
            self._fail(
                "not_operational", f"the valve's NMT state is {state}, not {OPERATIONAL} (operational)"
            )

    def _on_emergency(self, entry: Any) -> None:
        if self._running and entry.code & 0xFF00:
            description = entry.get_desc() or "of the maker"
            self._fail(
                "emergency",
                f"emergency 0x{entry.code:04X} ({description}), error register 0x{entry.register:02X}",
            )

    def _fail(self, name: str, text: str) -> None:
        """Switch the output off for a fault; it stays off until it is enabled anew."""
        if self._on or name == "node_reset":
            self._faults.setdefault(name, f"node {self._p['node']}: {text}; the output stays off until it is "
                                    "enabled anew")  # fmt: skip
        self._on = False

    # Configuration

    def enable(self, on: bool) -> None:
        """Bring the valve to ACTIVE or DISABLED with the signal of 0 V. Raises DriverError."""
        assert self._node is not None
        self._on = False
        self._node.pump(0.0)  # what waits is stale, but for a valve that has started anew
        if not self._running or self._faults:
            self._configure(self._node)
        self._ticks, self._lost = Ticks(self._period), 0
        self._on = on
        self._setpoint = self._counts(self._off)
        self._resetting = 2 if on else 0
        self._since = self._beat = time.monotonic()
        self._reached = False
        if not on and self._running:  # no read may follow
            self._send()
            self._node.send(SYNC)
            self._sent = False

    def _configure(self, node: "CanNode") -> None:
        """Configure the valve and start the exchange of PDOs."""
        self._running = False
        watched, self._consumed = configure(node, self._p)
        self._unwatched = not watched and self._p["watchdog"] > 0.0
        node.patience = 0.5 * self._p["watchdog"] if watched else node.patience
        self._beat_at = 0.0
        self._faults = {}
        self._status, self._lost_lately = 0b1000, Lately()
        self._running = True

    # Exchange

    def _counts(self, signal: float) -> int:
        counts = round(signal * self._reference / 100.0) if math.isfinite(signal) else 0
        return max(-32767, min(32767, counts))

    def _control(self) -> int:
        """Control word of this cycle."""
        if not self._on:
            return states.DISABLED
        if states.fault(self._status) and self._resetting:
            self._resetting -= 1
            return states.reset(self._status, edge=not self._resetting)
        return states.towards_active(self._status)

    def _send(self) -> None:
        assert self._node is not None
        setpoint = self._setpoint if self._on else self._counts(self._off)
        self._sent = self._node.send(0x200 + self._p["node"], DATA.pack(self._control(), setpoint))

    def write(self, signal: float) -> None:
        """Send the set point; it acts at the next SYNC, or when it arrives. Raises DriverError."""
        if self._running and self._on:
            self._setpoint = self._counts(signal)
            self._send()

    def read(self) -> Reading | None:
        """Send SYNC at the next tick and wait for the actual value. Raises DriverError."""
        node = self._node
        assert node is not None
        if not self._running:
            return self._polled(node)
        end = time.monotonic() + self._wait
        while True:
            while (left := self._ticks.due()) > 0.0:
                node.pump(left)
            node.pump(0.0)
            self._lost += self._ticks.take()
            if not self._sent:
                self._send()
            self._sent = False
            self._actual = None
            now = time.monotonic()
            if self._consumed and now >= self._beat_at and node.send(0x700 + self._consumed, OWN_STATE):
                self._beat_at = now + self._p["watchdog"] / BEATS
            node.send(SYNC)
            while self._actual is None and (left := self._ticks.due()) > 0.0:
                node.pump(left)
            self._watch(node)
            if self._actual is not None:
                lost, self._lost = self._lost, 0
                return Reading(100.0 * self._actual / self._reference, lost)
            self._lost += 1
            self._lost_lately.note()
            if time.monotonic() >= end:
                return None

    def _watch(self, node: "CanNode") -> None:
        """Judge what the valve and the bus tell in this cycle."""
        now = time.monotonic()
        if node.bus_off:
            self._fail("bus_off", "the CAN controller of this computer is bus off")
        limit = HEARTBEATS * self._p["heartbeat"]
        if limit and now > self._beat + limit:
            if self._lost * self._period > 0.5 * limit:
                self._fail(
                    "bus_silent", f"nothing has come for {1e3 * limit:.0f} ms: supply, cable or bus off"
                )
            else:
                self._fail("heartbeat_lost", f"no heartbeat for {1e3 * limit:.0f} ms")
        if self._actual is None or not self._on:
            return
        told = f"its state is {states.state(self._status)} (status word 0x{self._status:04X})"
        late = now > self._since + GRACE
        if states.active(self._status):
            self._reached, self._resetting = True, 0
        elif states.fault(self._status) and (self._reached or late):
            self._fail("fault", told)
        elif self._reached or late:
            self._fail("wrong_state", f"{told}, it must be ACTIVE")
        if self._status & states.LOCAL:
            self._fail("local_control", "it listens to its own control word (0x604F), not to the bus")

    def _polled(self, node: "CanNode") -> Reading | None:
        """The actual value by SDO, at most 100 times a second."""
        while (left := self._ticks.due()) > 0.0:
            node.pump(left)
        self._ticks.take()
        try:
            actual = node.get(0x6301, 1, "h")
        except LookupError as error:
            raise DriverError(str(error)) from error
        except DriverError:
            self._silent += 1
            if self._silent >= PATIENCE:
                raise
            return None
        self._silent = 0
        return Reading(100.0 * actual / self._reference, 0)

    def close(self) -> None:
        """Switch the valve's output off if PDOs were exchanged, and release the bus. Raises nothing."""
        node, self._node = self._node, None
        if node is None:
            return
        try:
            if self._running:
                off = DATA.pack(0, self._counts(self._off))
                node.send(0x200 + node.node, off)
                node.send(SYNC)
                node.command("PRE-OPERATIONAL")
                node.put(0x6040, 0, "H", 0)
        except (DriverError, LookupError):
            pass  # the valve's own watchdog does it
        self._running = self._on = False
        node.close()

    def conditions(self) -> tuple[Condition, ...]:
        """Faults that switched the output off, lost PDOs, a valve that does not watch its set point."""
        found = [Condition(name, "safe", text) for name, text in self._faults.items()]
        if self._running and self._lost_lately:
            found.append(
                Condition("pdo_lost", "degraded", f"{self._lost_lately.count} actual values did not come")
            )
        if self._node is not None and not self._running:
            found.append(
                Condition(
                    "polled",
                    "degraded",
                    "before enable the actual value is asked for by SDO, at "
                    "most 100 times a second; losses of PDOs do not show",
                )
            )
        if self._unwatched:
            found.append(
                Condition("no_watchdog", "degraded", "the valve watches neither its set "
                          "point (0x1400:05) nor a heartbeat (0x1016): it "
                          "would keep the last one if this process died")
            )  # fmt: skip
        return tuple(found)


def make(values: Values, period: float, off: float) -> Driver:
    """Driver from the values of `PARAMETERS`. Raises ParameterError if the bus is too slow."""
    bitrate = int(number(values, "canopen.bitrate"))
    needed = FRAMES / bitrate
    if needed > period:
        raise ParameterError(
            f"canopen.bitrate is {bitrate} bit/s; SYNC and two PDOs take up to {1e3 * needed:.2g} ms, longer "
            f"than sample_period, {1e3 * period:g} ms"
        )
    return Valve408(values, period, off)


KIND = Kind(
    name=NAME,
    text="a valve with CANopen, device profile CiA 408",
    parameters=PARAMETERS,
    make=make,
    extra=NAME,
    volts="%",
)
