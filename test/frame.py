# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads a frame of the page as its plots do."""

import json
import struct

import numpy as np


def signals_of(frame):
    """Signals of a frame by name, each with three rows: time, low, high."""
    (length,) = struct.unpack_from("<I", frame)
    head = json.loads(frame[4 : 4 + length])
    numbers, at, found = np.frombuffer(frame, "<f4", offset=4 + length), 0, {}
    for name, count in head["signals"]:
        found[name] = numbers[at : at + 3 * count].reshape(3, count)
        at += 3 * count
    return found
