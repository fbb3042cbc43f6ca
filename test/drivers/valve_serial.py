# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The serial card of the docs with its own clock, on a pseudo-terminal; faults are ordered on standard input.

Orders: ``lose N`` frames are not sent, ``damage N`` frames are damaged, ``sensor 0`` and ``silent 1`` until
they are taken back. The answer is the voltage at the amplifier, and whether the output is on.
"""

import os
import select
import sys
import time

from examples import serial_card


class Line:
    def __init__(self, period):
        self.card = serial_card.Card(period)
        self.damaged, self.silent = 0, False

    def order(self, word, value):
        if word == "lose":
            self.card.counter = (self.card.counter + int(value)) % 65536
        elif word == "damage":
            self.damaged = int(value)
        elif word == "sensor":
            self.card.sensor_sound = value == "1"
        elif word == "silent":
            self.silent = value == "1"

    def sample(self, now):
        self.card.receive(now)
        self.card.move()
        if not self.silent:
            self.card.send(now, 16 if self.damaged else 0)
            self.damaged = max(0, self.damaged - 1)


def main(period):
    line = Line(period)
    print(line.card.port, flush=True)
    due = time.monotonic() + period
    while True:
        if select.select([sys.stdin], [], [], max(0.0, due - time.monotonic()))[0]:
            text = os.read(sys.stdin.fileno(), 100).decode()  # one order at a time: the answer is waited for
            if not text:
                return
            word, _, value = text.strip().partition(" ")
            line.order(word, value)
            line.card.receive(time.monotonic())
            print(f"{line.card.voltage:.4f} {int(line.card._asked)}", flush=True)
        if time.monotonic() >= due:
            line.sample(time.monotonic())
            due += period


main(float(sys.argv[1]))
