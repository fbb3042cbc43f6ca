# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Packs what the plots of a page draw next into one binary message."""

import json
import math
import struct
from typing import NamedTuple

from valve_control.dashboard.history import EMPTY, LONGEST
from valve_control.dashboard.machine import Machine

MOST_COLUMNS = 4000
MOST_SIGNALS = 19  # four of the valve, six terms, six joints, goal and two pressures of the axis
SHORTEST = 0.01  # s
RIGHT = 0.03  # s  left of the present, so that the newest samples of all signals are there


class View(NamedTuple):
    """What a page wants to see."""

    valve: str
    signals: tuple[str, ...]
    span: float  # s
    end: float | None  # s, None: the present
    columns: int


class ViewError(ValueError):
    """Says what is wrong with a request for a frame."""


def view(text: str) -> View:
    """Read the request of a page. Raises ViewError."""
    try:
        request = json.loads(text)
        end = request["end"]
        wanted = View(
            str(request["valve"]),
            tuple(str(name) for name in request["signals"])[:MOST_SIGNALS],
            min(max(float(request["span"]), SHORTEST), LONGEST),
            None if end is None else float(end),
            min(max(int(request["columns"]), 10), MOST_COLUMNS),
        )
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise ViewError(f"this is no request for a frame: {error}") from error
    if not math.isfinite(wanted.span) or (wanted.end is not None and not math.isfinite(wanted.end)):
        raise ViewError("span and end must be finite")
    return wanted


def frame(machine: Machine, wanted: View, now: float) -> bytes:
    """A frame: length of the head (4 bytes), head as JSON, for each signal time, low and high as float32.

    Times are in seconds from the ``start`` that stands in the head. Numbers are of little-endian order.
    """
    end = now - RIGHT if wanted.end is None else wanted.end
    start = end - wanted.span
    with machine.lock:
        valve = machine.valves.get(wanted.valve)
        signals = valve.signals if valve is not None else {}
        courses = {
            name: signals[name].course(start, end, wanted.columns) if name in signals else EMPTY
            for name in wanted.signals
        }
        marks = [m for m in valve.marks if start <= m.time <= end] if valve is not None else []
        there = [name for name in signals if "." in name]
        live = valve is not None and valve.live(now)
    head = json.dumps(
        {
            "start": start,
            "end": end,
            "now": now,
            "live": live,
            "there": there,
            "signals": [[name, len(course.time)] for name, course in courses.items()],
            "marks": [[mark.time - start, mark.text] for mark in marks],
        }
    ).encode()
    head += b" " * (-len(head) % 4)
    parts = [struct.pack("<I", len(head)), head]
    for course in courses.values():
        for numbers in (course.time - start, course.low, course.high):
            parts.append(numbers.astype("<f4").tobytes())
    return b"".join(parts)
