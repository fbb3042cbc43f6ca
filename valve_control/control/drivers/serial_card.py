# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Driver `serial`: a card on a serial line that samples the LVDT by its own clock."""

import math
import os
import select
import termios
import time
from collections import deque
from contextlib import suppress
from typing import Any

from valve_control.control.drivers.driver import (
    Condition,
    Driver,
    DriverError,
    Kind,
    Reading,
    missing,
    patience,
)
from valve_control.control.drivers.serial_frames import (
    COUNTS,
    FROM_CARD,
    NUMBERS,
    ON,
    SENSOR,
    SILENCE,
    TO_CARD,
    Frame,
    Receiver,
    packed,
)
from valve_control.parameter import Parameter, Values, number, word

CHUNK = 4096  # bytes
MOST_LOST = 1000  # readings; a larger gap of the counter is that of a card that began anew
LATCH = 1.0  # s for which damaged frames stay reported
GRACE = 0.1  # s that the card may take to switch its output on
STALE = 0.1  # s of frames that may wait; after such a pause the card's watchdog has switched off

PARAMETERS = (
    Parameter("serial.port", "/dev/ttyUSB0", "", "serial port of the card"),
    Parameter("serial.baud", 460800, "bit/s", "speed of the line", 1200, 4_000_000),
    Parameter("serial.full_scale_in", 10.0, "", "signal of a reading of 32,767 counts", 1e-6, 1e6),
    Parameter("serial.full_scale_out", 10.0, "", "output signal of 32,767 counts", 1e-6, 1e6),
)


class SerialCard:
    """Driver of a card; ``off``: signal that gives 0 V."""

    def __init__(self, values: Values, period: float, off: float) -> None:
        self._name = word(values, "serial.port")
        self._baud = int(number(values, "serial.baud"))
        self._per_count = number(values, "serial.full_scale_in") / COUNTS
        self._counts = COUNTS / number(values, "serial.full_scale_out")
        self._off = off
        self._wait = patience(period)
        self._most_waiting = max(4, math.ceil(STALE / period))
        self._port: Any = None
        self._receiver = Receiver(FROM_CARD)
        self._waiting: deque[Frame] = deque()
        self._expected: int | None = None  # counter of the next frame
        self._counter = 0  # of the last frame to the card
        self._on = False
        self._flags = 0  # of the last frame
        self._switched = 0.0  # s, when the output was switched on
        self._damaged, self._damaged_until = 0, -math.inf

    def open(self) -> None:
        """Open the port. Raises DriverError."""
        try:
            import serial
        except ImportError:
            raise missing("pyserial", "serial", "serial") from None
        try:
            self._port = serial.Serial(self._name, self._baud, timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:  # SerialException is an OSError
            code = error.args[0] if isinstance(error, termios.error) else getattr(error, "errno", None)
            reason = os.strerror(code) if code else error
            raise DriverError(f"the port {self._name} cannot be opened: {reason}") from error
        with suppress(OSError, ValueError, AttributeError, NotImplementedError):  # a port without this mode
            self._port.set_low_latency_mode(True)  # a USB adapter would collect bytes for up to 16 ms
        self._poll = select.poll()
        self._poll.register(self._port.fileno(), select.POLLIN)
        try:
            self._drop()
        except DriverError:
            self.close()
            raise

    def _drop(self) -> None:
        """Forget what came until now. Raises DriverError if the port is gone."""
        try:
            while os.read(self._port.fileno(), CHUNK):
                pass
        except BlockingIOError:
            pass
        except OSError as error:
            raise self._gone(error) from error
        self._receiver.clear()
        self._waiting.clear()
        self._expected = None

    def enable(self, on: bool) -> None:
        """Switch the card's output on or off, at the signal of 0 V. Raises DriverError."""
        if on and not self._on:
            self._drop()
            self._switched = time.monotonic()
            self.write(self._off)  # without the flag ON: the card keeps this value for its watchdog
        self._on = on
        self.write(self._off)

    def write(self, signal: float) -> None:
        """Send an output signal, that of 0 V if it is off. Raises DriverError if the line takes no more."""
        self._counter = (self._counter + 1) % NUMBERS
        counts = max(-COUNTS, min(COUNTS, round((signal if self._on else self._off) * self._counts)))
        data = packed(TO_CARD, ON if self._on else 0, self._counter, counts)
        try:
            sent = os.write(self._port.fileno(), data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise self._gone(error) from error
        if sent < len(data):
            raise DriverError(f"the line {self._name} does not take the voltages: it is too slow, or held up")

    def read(self) -> Reading | None:
        """The next reading; None if no sound frame comes in time. Raises DriverError if the port is gone.

        If more than ``STALE`` seconds of frames wait, the newest is taken and the others count as lost.
        """
        end = time.monotonic() + self._wait
        while not self._waiting:
            rest = end - time.monotonic()
            if rest <= 0.0 or not self._poll.poll(math.ceil(1e3 * rest)):
                return None
            self._receive()
        return self.poll()

    def poll(self) -> Reading | None:
        """The next reading if it has come. Raises DriverError if the port is gone."""
        while self._poll.poll(0):
            self._receive()
        if not self._waiting:
            return None
        if len(self._waiting) > self._most_waiting:
            self._waiting = deque((self._waiting[-1],))
        return self._taken(self._waiting.popleft())

    def due(self) -> float:
        """At once if a frame waits here; otherwise the port has to be heard."""
        return 0.0 if self._waiting else math.inf

    def fileno(self) -> int:
        """The port."""
        return int(self._port.fileno())

    def _receive(self) -> None:
        try:
            data = os.read(self._port.fileno(), CHUNK)
        except BlockingIOError:
            return
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise DriverError(f"the port {self._name} is gone")
        self._waiting.extend(self._receiver.feed(data))

    def _taken(self, frame: Frame) -> Reading:
        lost = 0 if self._expected is None else (frame.counter - self._expected) % NUMBERS
        self._expected = (frame.counter + 1) % NUMBERS
        self._flags = frame.flags
        signal = math.nan if frame.flags & SENSOR else frame.value * self._per_count
        return Reading(signal, lost if lost <= MOST_LOST else 0)

    def _gone(self, error: OSError) -> DriverError:
        reason = error.strerror or str(error)
        return DriverError(f"the port {self._name} is gone: {reason}")

    def close(self) -> None:
        """Switch the output off if it is on, and close the port."""
        if self._port is None:
            return
        try:
            if self._on:
                self.enable(False)
        except DriverError:
            pass  # the card's own watchdog does it
        self._on = False
        self._port.close()
        self._port = None

    def conditions(self) -> tuple[Condition, ...]:
        """Faults that the card tells, and those of the line."""
        now = time.monotonic()
        if self._receiver.damaged != self._damaged:
            self._damaged, self._damaged_until = self._receiver.damaged, now + LATCH
        found = []
        if self._flags & SENSOR:
            found.append(Condition("sensor_fault", "degraded", "the card says that its reading is not valid"))
        if self._on and now > self._switched + GRACE:
            if self._flags & SILENCE:
                found.append(
                    Condition("card_silence", "safe", "no voltage reaches the card: its output is off")
                )
            elif not self._flags & ON:
                found.append(Condition("output_off", "safe", "the card keeps its output off"))
        if now < self._damaged_until:
            found.append(Condition("damaged_frames", "degraded", f"{self._damaged} frames came damaged"))
        return tuple(found)


def make(values: Values, period: float, off: float) -> Driver:
    """Driver from the values of `PARAMETERS`."""
    return SerialCard(values, period, off)


KIND = Kind("serial", "a card on a serial line", PARAMETERS, make, "serial")
