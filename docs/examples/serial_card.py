# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Plays the card of docs/examples/serial_card.c on a pseudo-terminal, with a simulated valve on it.

    python serial_card.py /tmp/card [PERIOD [SECONDS]]

makes the port /tmp/card and samples the valve each PERIOD (0.001 s) until SECONDS are over or Ctrl-C comes.
"""

import os
import pty
import sys
import time
import tty
from contextlib import suppress
from pathlib import Path

import numpy as np

from valve_control.control.drivers.serial_frames import (
    COUNTS,
    FROM_CARD,
    NUMBERS,
    ON,
    SENSOR,
    SILENCE,
    TO_CARD,
    Receiver,
    packed,
)
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import valve
from valve_control.parameter import defaults, updated

WATCHDOG = 0.1  # s without a sound frame, after which the output is off
FULL_SCALE = 10.0  # V


class Card:
    """The firmware, with amplifier, valve and LVDT behind it. Times are those that its caller gives."""

    def __init__(self, period: float = 0.001, **changes: object) -> None:
        """``changes``: parameters of the simulated valve, with ``__`` for a dot."""
        self.line, self._other_end = pty.openpty()
        tty.setraw(self.line)
        tty.setraw(self._other_end)
        os.set_blocking(self.line, False)
        self.port = os.ttyname(self._other_end)
        wanted = {name.replace("__", "."): value for name, value in changes.items()}
        self._params = build.valve_params(
            updated(VALVE, defaults(VALVE), {**wanted, "sample_period": period})
        )
        self._state = valve.initial(self._params)
        self._random = np.random.default_rng(1)
        self._receiver = Receiver(TO_CARD)
        self._heard = -WATCHDOG  # s, the last sound frame
        self._asked = False  # by the host: output on
        self.frames = 0  # sound ones from the host
        self.counter = 0
        self.voltage = 0.0  # V, to the amplifier
        self._rest = 0.0  # V, of the last frame that switched off: the signal of 0 V
        self.sensor_sound = True

    def receive(self, now: float) -> None:
        """Use the frames that have come, at ``now`` [s]; switch off if none has for the watchdog's time."""
        data = b""
        with suppress(BlockingIOError, OSError):  # nothing, or nobody has the port open
            while more := os.read(self.line, 4096):
                data += more
        for frame in self._receiver.feed(data):
            self._heard, self._asked = now, bool(frame.flags & ON)
            self.voltage = frame.value * FULL_SCALE / COUNTS
            if not self._asked:
                self._rest = self.voltage
            self.frames += 1
        if now - self._heard >= WATCHDOG:
            self._asked, self.voltage = False, self._rest

    def send(self, now: float, damage: int = 0) -> float:
        """Sample the LVDT and send the reading [V], which is returned; ``damage``: bits to turn over."""
        reading = valve.read(self._params, self._state, float(self._random.standard_normal()))
        flags = (
            ON * self._asked | SILENCE * (now - self._heard >= WATCHDOG) | SENSOR * (not self.sensor_sound)
        )
        counts = max(-COUNTS, min(COUNTS, round(reading / FULL_SCALE * COUNTS)))
        data = bytearray(packed(FROM_CARD, flags, self.counter, counts))
        data[4] ^= damage
        with suppress(BlockingIOError):  # nobody reads
            os.write(self.line, data)
        self.counter = (self.counter + 1) % NUMBERS
        return reading

    def move(self) -> None:
        """Let the valve move for a sample period under the present voltage."""
        self._state = valve.step(self._params, self._state, self.voltage)

    def close(self) -> None:
        """Take the port away."""
        os.close(self.line)
        os.close(self._other_end)


def main(link: str, period: float = 0.001, seconds: float = 1e9) -> None:
    """Run a card in real time, with a port named ``link``."""
    card = Card(period, lvdt__noise=0.003, friction__coulomb=0.5)
    Path(link).unlink(missing_ok=True)
    Path(link).symlink_to(card.port)
    print(f"the card is on {link}", flush=True)
    begun = due = time.monotonic()
    try:
        while due < begun + seconds:
            due += period
            time.sleep(max(0.0, due - time.monotonic()))
            card.receive(time.monotonic())
            card.move()
            card.send(time.monotonic())
    except KeyboardInterrupt:
        pass
    finally:
        Path(link).unlink(missing_ok=True)
        card.close()


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
