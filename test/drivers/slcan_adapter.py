# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""An slcan adapter: a pseudo-terminal whose other end is a CAN bus of python-can."""

import fcntl
import os
import pty
import select
import struct
import termios
import tty
from contextlib import suppress
from queue import SimpleQueue

import can
from can.interfaces.slcan import slcanBus


class Line:
    """The adapter's end of the line, as slcanBus wants a serial port."""

    write_timeout = None

    def __init__(self):
        self._fd, self.slave = pty.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self._fd, False)
        self.name = os.ttyname(self.slave)

    @property
    def in_waiting(self):
        return struct.unpack("i", fcntl.ioctl(self._fd, termios.FIONREAD, b"\0\0\0\0"))[0]

    def read(self, size):
        if not select.select([self._fd], [], [], 0.001)[0]:
            return b""
        return os.read(self._fd, size)

    def write(self, data):
        with suppress(BlockingIOError):  # nobody reads: the frame is lost
            os.write(self._fd, data)

    def flush(self):
        pass

    def reset_input_buffer(self):
        pass

    def close(self):
        os.close(self._fd)
        os.close(self.slave)

    def fileno(self):
        return self._fd


class Adapter(slcanBus):
    """Passes frames only while it is open; bus off, it passes none."""

    def __init__(self):
        self.serialPortOrig = Line()
        self._queue, self._buffer, self._listen_only = SimpleQueue(), bytearray(), False
        self._can_protocol = can.CanProtocol.CAN_20
        self.opened = self.bus_off = False
        can.BusABC.__init__(self, self.serialPortOrig.name)

    def _read(self, timeout):
        text = super()._read(timeout)
        if text and text[0] in "OC":
            self.opened = text[0] == "O"
        return None if self.bus_off else text

    def send(self, msg, timeout=None):
        if self.opened and not self.bus_off:
            super().send(msg, timeout)
