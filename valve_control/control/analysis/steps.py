# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures how a position answers steps of its command: overshoot and settling time."""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats

BAND = 0.02  # of the height of a step, within which the position has settled
SMALL = 0.1  # of the largest step of a command
LEAST = 0.05  # s  that a command stands after a step, at least


class Answer(NamedTuple):
    """How N positions answer the steps of one command, the worst step of each."""

    overshoot: Floats  # -  of the height of the step, beyond its end
    settling: Floats  # s  until the position stays within BAND; inf: it does not


def places(command: Floats, period: float) -> list[tuple[int, int]]:
    """First sample of each step of ``command`` (n) [V], and that of the next one.

    [] for one that moves otherwise. A step of less than SMALL of the largest one is none to judge.
    """
    heights = np.diff(command)
    changes = np.flatnonzero(heights) + 1
    ends = [*changes[1:].tolist(), len(command)]
    if not len(changes) or min(np.array(ends) - changes) * period < LEAST:
        return []
    large = np.abs(heights) >= SMALL * np.max(np.abs(heights))
    return [(first, end) for first, end in zip(changes.tolist(), ends, strict=True) if large[first - 1]]


def answer(command: Floats, position: Floats, period: float) -> Answer | None:
    """How ``position`` (…×n) [V] answers the steps of ``command`` (n) [V]; None for one without steps."""
    several = answers(command, position, period)
    return Answer(*np.max(several, axis=0)) if several else None


def answers(command: Floats, position: Floats, period: float) -> list[Answer]:
    """How ``position`` (…×n) [V] answers each of the steps of ``command`` (n) [V]."""
    several = []
    for first, end in places(command, period):
        height = command[first] - command[first - 1]
        beyond = (position[..., first:end] - command[first]) / height
        outside = ~(np.abs(beyond) <= BAND)  # NaN too
        last = (end - first) - np.argmax(outside[..., ::-1], axis=-1)
        time = np.where(np.any(outside, axis=-1), last * period, 0.0)
        settled = np.where(outside[..., -1], np.inf, time)
        several.append(Answer(np.maximum(0.0, np.max(beyond, axis=-1)), settled))
    return several


def in_words(overshoot: float, settling: float) -> str:
    """One line of the worst step."""
    rest = f"{1e3 * settling:.3g} ms" if np.isfinite(settling) else "not while the command stands"
    return f"overshoot {100.0 * overshoot:.2g} %, settled to {100.0 * BAND:g} %: {rest}"
