# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Driver of an analogue I/O device on Modbus TCP: one register in, one out, polled at an absolute clock.

A reading is one request of one register, an output another. The library is pymodbus, which is imported
when the driver is opened.
"""

import logging
import math
import time
from collections.abc import Callable
from typing import Any

from valve_control.control.drivers.driver import Condition, DriverError, Kind, Reading, missing
from valve_control.control.drivers.ticks import Lately, Ticks
from valve_control.parameter import Parameter, Values

NAME = "modbus"
BUSY = 6  # exception code: the device answers later
MEANINGS = {
    1: "function not known",
    2: "no such address",
    3: "value not allowed",
    4: "device failure",
    5: "accepted, not done yet",
    BUSY: "busy",
    10: "gateway has no path",
    11: "no answer behind the gateway",
}
PATIENCE = 3  # unanswered requests in a row before the connection counts as lost
ATTEMPTS = 5  # requests to a busy device, spread over the timeout

PARAMETERS = (
    Parameter("modbus.host", "127.0.0.1", "", "name or address of the device"),
    Parameter("modbus.port", 502, "-", "its TCP port", low=1, high=65535),
    Parameter("modbus.unit", 1, "-", "unit identifier, often 1 or 255", low=0, high=255),
    Parameter("modbus.input", 0, "-", "address of the LVDT's register, counted from 0", low=0, high=65535),
    Parameter("modbus.input_kind", "input", "", "kind of this register", choices=("input", "holding")),
    Parameter("modbus.output", 0, "-", "address of the amplifier's holding register", low=0, high=65535),
    Parameter("modbus.enable_coil", -1, "-", "address of the coil that switches the amplifier on, -1: none",
              low=-1, high=65535),
    Parameter("modbus.counts", 3276.7, "-", "counts of a register for one unit of the signal (V, % or mA)",
              low=1e-3, high=65535.0),
    Parameter("modbus.signed", True, "", "registers are signed numbers of 16 bit (false: from 0 up)"),
    Parameter("modbus.timeout", 0.05, "s", "a request not answered for so long is lost", low=0.002, high=1.0),
)  # fmt: skip


class ModbusTcp:
    """The device behind one TCP connection."""

    def __init__(self, values: Values, period: float, off: float) -> None:
        self._p: dict[str, Any] = {name.removeprefix(f"{NAME}."): value for name, value in values.items()}
        self._period = period
        self._off = off
        self._on = self._touched = False  # output stage on; something was written
        self._held = False  # a voltage may be in the output register
        self._lost = 0
        self._silent = 0  # unanswered requests in a row
        self._partial = False  # bytes of an answer have come
        self._timeouts, self._late, self._busy = Lately(), Lately(), Lately()
        self._refused: dict[str, str] = {}
        self._client: Any = None

    def open(self) -> None:
        """Connect and ask for one reading; nothing is written before ``enable``. Raises DriverError."""
        try:
            from pymodbus.client import ModbusTcpClient
        except ImportError:
            raise missing("pymodbus", NAME, NAME) from None
        logging.getLogger("pymodbus").addHandler(logging.NullHandler())  # what it logs is said here
        p = self._p
        self._client = ModbusTcpClient(p["host"], port=p["port"], timeout=p["timeout"], retries=0)
        receive = self._client.recv

        def received(size: int | None) -> bytes:
            data: bytes = receive(size)
            self._partial = self._partial or len(data) > 0
            return data

        self._client.recv = received
        self._refused, self._silent, self._on, self._touched = {}, 0, False, False
        try:
            if not self._client.connect():
                raise DriverError(
                    f"no Modbus device answers at {self._where}; check modbus.host and modbus.port"
                )
            answer = self._ask()
            if answer is None:
                raise DriverError(
                    f"{self._where} is connected but does not answer within {p['timeout']:g} s; check "
                    "modbus.unit, or raise modbus.timeout"
                )
            if answer.isError():
                raise DriverError(f"{self._where} refuses {self._input}: {_exception(answer)}")
        except DriverError:
            self.close()
            raise
        self._ticks, self._lost = Ticks(self._period), -1  # there is no reading before the first

    def enable(self, on: bool) -> None:
        """Write the signal of 0 V, then switch the coil if there is one. Raises DriverError."""
        self._refused.pop("write_refused", None)
        self._on, self._touched = False, True
        self._switched(on)
        self._on = on and "write_refused" not in self._refused
        self._ticks, self._lost = Ticks(self._period), 0

    def write(self, signal: float) -> None:
        """Write the output register and wait for the answer. Raises DriverError if the connection is lost.

        If the voltage is refused, the output goes to 0 V and off; a DriverError says if this fails too.
        """
        if self._on:
            self._held = True
            answer = self._request("write_register", self._p["output"], self._counts(signal))
            if answer is not None and self._is_refused("write_refused", answer, self._output):
                self._on = False
                self._switched(False)

    def read(self) -> Reading | None:
        """Read the input register at the next tick; None if it was not answered. Raises DriverError."""
        missed = self._ticks.wait()
        if self._lost >= 0:
            self._lost += missed
            if missed:
                self._late.note(missed)
        answer = self._ask()
        if answer is None or answer.isError():
            self._lost = max(0, self._lost) + 1
            if answer is not None:
                self._is_refused("read_refused", answer, self._input)
            return None
        self._refused.pop("read_refused", None)
        counts = answer.registers[0]
        if self._p["signed"] and counts >= 1 << 15:
            counts -= 1 << 16
        lost, self._lost = max(0, self._lost), 0
        return Reading(counts / self._p["counts"], lost)

    def close(self) -> None:
        """Switch off if ``enable`` was ever called and the device can be reached; close the connection."""
        for _ in range(PATIENCE):
            if not self._touched or self._client is None or not self._client.connected:
                break
            try:
                self.enable(False)
                break
            except DriverError:
                continue
        if self._client is not None:
            self._client.close()
        self._client, self._on = None, False

    def conditions(self) -> tuple[Condition, ...]:
        """Requests without an answer, refused ones, a device that is slower than the sample period."""
        found = []
        for name, sentence in self._refused.items():
            found.append(Condition(name, "safe" if name == "write_refused" else "degraded", sentence))
        if self._timeouts:
            found.append(Condition("timeout", "degraded", f"{self._timeouts.count} requests had no answer"))
        if self._busy:
            found.append(Condition("busy", "degraded", f"the device was busy {self._busy.count} times"))
        if self._late:
            found.append(
                Condition("late", "degraded", f"{self._late.count} samples were left out; the device or the "
                          f"network is slower than the sample period of {1e3 * self._period:g} ms")
            )  # fmt: skip
        return tuple(found)

    @property
    def _where(self) -> str:
        return f"{self._p['host']}:{self._p['port']} (unit {self._p['unit']})"

    @property
    def _input(self) -> str:
        return f"{self._p['input_kind']} register {self._p['input']}"

    @property
    def _output(self) -> str:
        return f"holding register {self._p['output']}"

    def _counts(self, signal: float) -> int:
        """Content of the output register for ``signal``, at the end of its range if it lies beyond."""
        counts = round(signal * self._p["counts"]) if math.isfinite(signal) else 0
        if self._p["signed"]:
            return max(-(1 << 15), min((1 << 15) - 1, counts)) & 0xFFFF
        return max(0, min(0xFFFF, counts))

    def _ask(self) -> Any:
        return self._request(f"read_{self._p['input_kind']}_registers", self._p["input"])

    def _zero(self) -> Any:
        return self._request("write_register", self._p["output"], self._counts(self._off))

    def _request(self, name: str, *words: int | bool) -> Any:
        """Answer of the device, None if none came in time. Raises DriverError if the connection is lost."""
        from pymodbus.exceptions import ConnectionException, ModbusException

        try:
            if self._client is None or not self._client.connected:
                raise ConnectionException("closed")
            self._partial = False
            answer = getattr(self._client, name)(*words, device_id=self._p["unit"])
        except (ConnectionException, OSError):
            self._drop()
            raise DriverError(f"{self._where} closed the connection") from None
        except ModbusException:
            self._silent += 1
            self._timeouts.note()
            if self._silent >= PATIENCE:
                self._drop()
                raise DriverError(f"{self._where} has not answered {PATIENCE} requests in a row") from None
            if self._partial:  # the rest of the answer would be taken for the beginning of the next
                self._client.close()
                if not self._client.connect():
                    self._drop()
                    raise DriverError(f"{self._where} closed the connection") from None
            return None
        self._silent = 0
        return answer

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client, self._on = None, False

    def _switched(self, on: bool) -> None:
        """Write the signal of 0 V, then the coil. Raises DriverError if a voltage stays on the output."""
        zero = self._answered(self._zero, self._output)
        self._held = self._held and not zero
        coil = self._p["enable_coil"]
        switched = on and zero
        off = coil >= 0 and self._answered(
            lambda: self._request("write_coil", coil, switched), f"coil {coil}"
        )
        if self._held and not off:
            raise DriverError(f"{self._refused['write_refused']}; the last voltage stays on the output")

    def _answered(self, ask: Callable[[], Any], what: str) -> bool:
        """Whether the device accepts a request. Raises DriverError if it does not answer or stays busy."""
        for attempt in range(ATTEMPTS):
            if attempt:
                time.sleep(self._p["timeout"] / ATTEMPTS)
            answer = ask()
            if answer is None:
                raise DriverError(f"{self._where} does not answer to {what}")
            if not answer.isError() or answer.exception_code != BUSY:
                return not self._is_refused("write_refused", answer, what)
            self._busy.note()
        raise DriverError(f"{self._where} stays busy and does not accept {what}")

    def _is_refused(self, name: str, answer: Any, what: str) -> bool:
        if not answer.isError():
            return False
        if answer.exception_code == BUSY:
            self._busy.note()
            return False
        self._refused[name] = f"{self._where} refuses {what}: {_exception(answer)}"
        return True


def _exception(answer: Any) -> str:
    code = answer.exception_code
    return f"exception {code} ({MEANINGS.get(code, 'of the device')})"


KIND = Kind(
    name=NAME,
    text="analogue input and output on Modbus TCP",
    parameters=PARAMETERS,
    make=ModbusTcp,
    extra=NAME,
)
