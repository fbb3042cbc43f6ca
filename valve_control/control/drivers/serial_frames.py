# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Frames between host and card on a serial line: eight bytes in both directions, with counter and CRC.

| byte | content |
|---|---|
| 0 | head: A5 from the card, 5A to it |
| 1 | flags |
| 2, 3 | counter of frames, low byte first, from 65,535 to 0 |
| 4, 5 | value, a signed number of 16 bit, low byte first |
| 6, 7 | CRC-16 of bytes 0 to 5, low byte first: polynomial 1021, begins with FFFF (CCITT-FALSE) |
"""

import struct
from binascii import crc_hqx
from typing import NamedTuple

FROM_CARD, TO_CARD = 0xA5, 0x5A
BODY = struct.Struct("<BBHh")
CRC = struct.Struct("<H")
SIZE = BODY.size + CRC.size
COUNTS = 32767  # value of full scale
NUMBERS = 2**16  # of the counter
ON = 1  # flag, to the card: switch the output on; from the card: it is on
SILENCE = 2  # flag, from the card: no frame came for its watchdog's time, its output is off
SENSOR = 4  # flag, from the card: the reading is not valid


class Frame(NamedTuple):
    """One sound frame."""

    flags: int
    counter: int
    value: int


def packed(head: int, flags: int, counter: int, value: int) -> bytes:
    """A frame as it travels."""
    body = BODY.pack(head, flags, counter, value)
    return body + CRC.pack(crc_hqx(body, 0xFFFF))


class Receiver:
    """Finds the sound frames in a stream of bytes."""

    def __init__(self, head: int) -> None:
        self._head = head
        self._data = b""
        self.damaged = 0  # heads that were followed by no sound frame

    def clear(self) -> None:
        """Forget what has come of a frame."""
        self._data = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Sound frames that end in ``data``, oldest first."""
        data = self._data + data
        frames: list[Frame] = []
        at = 0
        while len(data) - at >= SIZE:
            body = data[at : at + BODY.size]
            head, flags, counter, value = BODY.unpack(body)
            if head == self._head and crc_hqx(body, 0xFFFF) == CRC.unpack_from(data, at + BODY.size)[0]:
                frames.append(Frame(flags, counter, value))
                at += SIZE
                continue
            self.damaged += head == self._head
            beginning = data.find(self._head, at + 1)
            at = beginning if beginning >= 0 else len(data)
        self._data = data[at:]
        return frames
