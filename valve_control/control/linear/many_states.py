# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes one compiled step of a law from many states at once; the bits are those of the plain step."""

import types
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.compiling import LANES, compile_function, explained
from valve_control.control.laws.law import Law
from valve_control.control.laws.places import law_step


class StatePoint(NamedTuple):
    """A state, with the reading [V] that comes to it, or the voltage [V] that led to it."""

    state: Any
    number: float


def load(like: Any, block: Floats, lane: int) -> Any:
    """Placeholder for ``simd_layout.load``."""
    raise NotImplementedError


def store(value: Any, block: Floats, lane: int) -> None:
    """Placeholder for ``simd_layout.store``."""
    raise NotImplementedError


def step_blocks(p: Any, like: StatePoint, before: Floats, after: Floats) -> None:
    """One step at a command of 0 V from the LANES points in each row of ``before`` to those of ``after``."""
    for i in range(before.shape[0]):
        for j in range(LANES):
            point = load(like, before[i], j)
            voltage, state, _ = law_step(p, point.state, 0.0, point.number, 0.0)
            store(StatePoint(state, voltage), after[i], j)


@cache
def _compiled(law: types.ModuleType) -> Callable[..., None]:
    from valve_control.control import simd_layout

    parts = {
        "load": simd_layout.load,
        "store": simd_layout.store,
        "law_step": compile_function(law.step),
    }
    return compile_function(step_blocks, parts, nogil=True)


def stepped(law: Law, params: Any, like: Any, points: Floats) -> Floats:
    """Next state and voltage [V] (M×n) from states and readings [V] (M×n), at a command of 0 V.

    ``like``: a state of the law, whose numbers come in the order of ``linear_loop.flatten``.
    """
    count, width = points.shape
    blocks = -(-count // LANES)
    padded = np.resize(points, (blocks * LANES, width))
    before = np.ascontiguousarray(padded.reshape(blocks, LANES, width).transpose(0, 2, 1))
    after = np.empty((blocks, width * LANES))
    with explained(law.title):
        _compiled(law.module)(
            p=params, like=StatePoint(like, 0.0), before=before.reshape(blocks, -1), after=after
        )
    return after.reshape(blocks, width, LANES).transpose(0, 2, 1).reshape(-1, width)[:count]
