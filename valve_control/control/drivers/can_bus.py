# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""One node on a CAN bus: SDO, NMT, heartbeat and emergencies by the library canopen, all in one thread.

The thread that calls reads the bus itself while it waits, so no frame crosses threads. This file is imported
when a driver is opened: it needs canopen and python-can.
"""

import contextlib
import errno
import logging
import math
import select
import struct
import time
from collections.abc import Callable
from typing import Any

import can
import canopen
from canopen.sdo import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from valve_control.control.drivers.driver import DriverError

BUS_OFF = 0x40  # in the identifier of an error frame
SEND_TIMEOUT = 0.05  # s


class Client(SdoClient):
    """An SDO client that reads the bus while it waits for the answer.

    All objects have up to four bytes, so that each answer names its object. An answer that comes after its
    time-out is not taken for that of a later request: it has another object, or one more answer follows.
    """

    pump: Callable[[float], None]
    _asked = b""  # object of the last request
    _owed = b""  # object whose answer has not come in time

    def request_response(self, sdo_request: bytes) -> bytes:
        """The node's answer to a request. Raises SdoCommunicationError, SdoAbortedError, CanError."""
        self.pump(0.0)
        if not self.responses.empty():  # it is dropped
            self._owed = b""
        self._asked = bytes(sdo_request[1:4])
        return bytes(super().request_response(sdo_request))

    def read_response(self) -> bytes:
        """The node's answer. Raises SdoCommunicationError, SdoAbortedError."""
        end, found = time.monotonic() + self.RESPONSE_TIMEOUT, b""
        while (left := end - time.monotonic()) > 0.0:
            if self.responses.empty():
                self.pump(left)
                continue
            answer: bytes = self.responses.get()
            if answer[1:4] == self._asked:
                found, late, self._owed = answer, self._owed == self._asked, b""
                if not late:
                    break
        if not found:
            self._owed = self._asked
            raise SdoCommunicationError("no answer")
        self.responses.put(found)
        return bytes(super().read_response())


class Network(canopen.Network):
    """A network that does not wait for ever for an adapter that takes no frames."""

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame. Raises CanError if it is not taken in time."""
        frame = can.Message(arbitration_id=can_id, is_extended_id=False, data=data, is_remote_frame=remote)
        self.bus.send(frame, timeout=SEND_TIMEOUT)


class CanNode:
    """The bus, and the one node on it that is spoken to."""

    def __init__(self, node: int, sdo_timeout: float, **bus: Any) -> None:
        """``bus``: words for `can.Bus`. Raises DriverError if there is no such bus."""
        for library in ("can", "canopen"):
            logging.getLogger(library).addHandler(logging.NullHandler())  # what it logs is said here
        self.node = node
        self.bus_off = False
        self.patience = SEND_TIMEOUT  # s for which a full buffer is no fault
        self._full_since = math.inf  # s
        try:
            self._bus = can.Bus(**bus)
        except Exception as error:  # the makers' libraries raise all kinds of errors
            raise DriverError(f"no CAN bus {bus['channel']} ({bus['interface']}): {error}") from error
        port = getattr(self._bus, "serialPortOrig", None)  # of slcan
        if port is not None:
            port.flush = lambda: None  # it would wait without limit for an adapter that takes no bytes
        try:
            self._fileno = self._bus.fileno()
        except (NotImplementedError, can.CanError):
            self._fileno = -1
        self._network = Network(self._bus)
        self._remote = canopen.RemoteNode(node, canopen.ObjectDictionary())
        self._sdo = Client(0x600 + node, 0x580 + node, self._remote.object_dictionary)
        self._sdo.RESPONSE_TIMEOUT, self._sdo.pump = sdo_timeout, self.pump
        self._remote.sdo, self._remote.sdo_channels = self._sdo, [self._sdo]
        self._network.add_node(self._remote)

    def on(self, identifier: int, call: Callable[[int, bytes, float], None]) -> None:
        """Call ``call`` with identifier, data and time of each frame with this identifier."""
        self._network.subscribe(identifier, call)

    def on_heartbeat(self, call: Callable[[int], None]) -> None:
        """Call ``call`` with the state in each heartbeat, 0 when the node has started."""
        self._remote.nmt.add_heartbeat_callback(call)

    def on_emergency(self, call: Callable[[Any], None]) -> None:
        """Call ``call`` with each emergency message."""
        self._remote.emcy.add_callback(call)

    def pump(self, limit: float) -> None:
        """Wait at most ``limit`` [s] for frames, and pass on all that are there. Raises DriverError."""
        try:
            while self._readable(limit):
                message = self._bus.recv(limit if self._fileno < 0 else 0.0)
                if message is None:
                    return
                limit = 0.0
                self._take(message)
        except (can.CanError, OSError, ValueError) as error:
            raise DriverError(f"the CAN bus is gone: {error}") from error

    def _readable(self, limit: float) -> bool:
        return self._fileno < 0 or bool(select.select([self._fileno], [], [], limit)[0])

    def _take(self, message: Any) -> None:
        if message.is_error_frame:
            self.bus_off |= bool(message.arbitration_id & BUS_OFF)
        elif not message.is_remote_frame:
            with contextlib.suppress(struct.error):  # a frame that is too short
                self._network.notify(message.arbitration_id, message.data, message.timestamp)

    def send(self, identifier: int, data: bytes = b"") -> bool:
        """Send a frame; whether it was taken: the buffer may be full for ``patience``. Raises DriverError."""
        try:
            self._network.send_message(identifier, data)
        except (can.CanError, OSError) as error:
            now = time.monotonic()
            self._full_since = min(self._full_since, now)
            number = getattr(error, "error_code", None) or getattr(error, "errno", None)
            if number != errno.ENOBUFS or now > self._full_since + self.patience:
                raise DriverError(f"the CAN bus does not take frames: {error}") from error
            return False
        self._full_since = math.inf
        return True

    def command(self, state: str) -> None:
        """Send the NMT command for ``state``, such as OPERATIONAL. Raises DriverError."""
        try:
            self._remote.nmt.state = state
        except (can.CanError, OSError) as error:
            raise DriverError(f"the CAN bus does not take frames: {error}") from error

    def get(self, index: int, sub: int, form: str) -> int:
        """Number in the object dictionary, ``form`` as for struct. Raises DriverError, LookupError."""
        try:
            data = self._sdo.upload(index, sub)
            value: int = struct.unpack_from(f"<{form}", data)[0]
        except SdoAbortedError as error:
            raise LookupError(f"node {self.node} refuses object 0x{index:04X}:{sub:02X}: {error}") from error
        except (SdoCommunicationError, struct.error) as error:
            raise DriverError(
                f"node {self.node} does not answer for object 0x{index:04X}:{sub:02X}"
            ) from error
        except (can.CanError, OSError) as error:
            raise DriverError(f"the CAN bus does not take frames: {error}") from error
        return value

    def put(self, index: int, sub: int, form: str, value: int) -> None:
        """Write a number to the object dictionary. Raises DriverError, LookupError if it is refused."""
        try:
            self._sdo.download(index, sub, struct.pack(f"<{form}", value))
        except SdoAbortedError as error:
            what = f"{value} in object 0x{index:04X}:{sub:02X}"
            raise LookupError(f"node {self.node} refuses {what}: {error}") from error
        except SdoCommunicationError as error:
            raise DriverError(
                f"node {self.node} does not answer for object 0x{index:04X}:{sub:02X}"
            ) from error
        except (can.CanError, OSError) as error:
            raise DriverError(f"the CAN bus does not take frames: {error}") from error

    def close(self) -> None:
        """Release the bus."""
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()
        port = getattr(self._bus, "serialPortOrig", None)
        if port is not None:  # it stays open if the adapter does not take its last command
            with contextlib.suppress(OSError):
                port.close()
