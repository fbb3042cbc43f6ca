# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Packs what the plots of a page draw next into one binary message."""

import json
import math
import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.dashboard.history import EMPTY, KEPT, Course
from valve_control.dashboard.machine import Machine
from valve_control.dashboard.valve import Valve

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
        given = json.loads(text)
        end = given["end"]
        made = View(
            str(given["valve"]),
            tuple(str(name) for name in given["signals"])[:MOST_SIGNALS],
            min(max(float(given["span"]), SHORTEST), KEPT),
            None if end is None else float(end),
            min(max(int(given["columns"]), 10), MOST_COLUMNS),
        )
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise ViewError(f"this is no request for a frame: {error}") from error
    if not math.isfinite(made.span) or (made.end is not None and not math.isfinite(made.end)):
        raise ViewError("span and end must be finite")
    return made


def frame(machine: Machine, wanted: View, now: float) -> bytes:
    """A frame: length of the head (4 bytes), head as JSON, for each signal time, low and high as float32.

    Times are in seconds from the ``start`` that stands in the head. Numbers are of little-endian order.
    """
    end = now - RIGHT if wanted.end is None else wanted.end
    start = end - wanted.span
    with machine.lock:
        valve = machine.valves.get(wanted.valve)
        courses = {name: _course(valve, name, start, end, wanted.columns) for name in wanted.signals}
        marks = [m for m in valve.marks if start <= m.time <= end] if valve is not None else []
        labels = valve.labels if valve is not None else ()
        axis = list(valve.axis) if valve is not None else []
        live = valve is not None and valve.live(now)
    head = json.dumps(
        {
            "start": start,
            "end": end,
            "now": now,
            "live": live,
            "labels": labels,
            "axis": axis,
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


def _course(valve: Valve | None, name: str, start: float, end: float, columns: int) -> Course:
    if valve is None:
        return EMPTY
    kind, _, own = name.partition(".")
    known = {"term": valve.terms, "axis": valve.axis}.get(kind, {})
    history = valve.signals.get(name) or known.get(own)
    return EMPTY if history is None else history.course(start, end, columns)


def sample(frame: bytes) -> dict[str, npt.NDArray[np.float32]]:
    """Signals of a frame by name, each with three rows: time, low, high."""
    (length,) = struct.unpack_from("<I", frame)
    head = json.loads(frame[4 : 4 + length])
    numbers, at, made = np.frombuffer(frame, "<f4", offset=4 + length), 0, {}
    for name, count in head["signals"]:
        made[name] = numbers[at : at + 3 * count].reshape(3, count)
        at += 3 * count
    return made
