# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds the linear form of any law and any valve for small motions, and poles and response of their loop.

The law's own step around rest is differentiated numerically, so that nothing has to be derived for a law, and
one of another package is treated like those of this one. Friction, resolution and saturation have no linear
form: their effect shows in a run.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Complexes, Floats
from valve_control.control.compiling import LANES, LawError, compile_function, explained
from valve_control.control.laws.law import Law
from valve_control.control.laws.places import law_step
from valve_control.control.laws.signals import Start
from valve_control.control.plant import registry

SCALE = 1e-6  # first disturbance of a state; the unit is that of the state
SMALL = 1e-3  # V  by which a disturbance moves the voltage at most: far from saturation
FINER = 1e-3  # factor to a smaller disturbance
Steps = Callable[[Law, Any, Any, Floats], Floats]  # see ``stepped``
SETTLING = 2  # samples at rest, after which the law has begun


class LinearLaw(NamedTuple):
    """x⁺ = a·x + b·y and u = c·x + d·y, of the states through which the reading y gets to the voltage u."""

    a: Floats  # n×n
    b: Floats  # n
    c: Floats  # n  V
    d: float  # V/V


class LinearValves(NamedTuple):
    """x⁺ = a·x + b·u and y(k + late) = now·x(k) + before·x(k-1), for each of N valves."""

    a: Floats  # N×m×m, with the flow force
    b: Floats  # N×m
    now: Floats  # N×m
    before: Floats  # N×m
    late: npt.NDArray[np.int64]  # N  whole periods of dead time


def flatten(state: Any) -> list[float]:
    """Numbers of a nested NamedTuple, in their order."""
    if isinstance(state, tuple):
        return [number for field in state for number in flatten(field)]
    return [state]


def unflatten(like: Any, numbers: list[float]) -> Any:
    """NamedTuple of the shape of ``like`` that holds ``numbers``; the list is used up."""
    if isinstance(like, tuple):
        return type(like)(*(unflatten(field, numbers) for field in like))
    return numbers.pop(0)


def stepped(law: Law, params: Any, like: Any, points: Floats) -> Floats:
    """Next state and voltage [V] (M×n) from states and readings [V] (M×n), at a command of 0 V.

    ``like``: a state of the law.
    """
    rows = []
    with explained(law.title):
        for *numbers, reading in points.tolist():
            voltage, state, _ = law.module.step(params, unflatten(like, numbers), 0.0, reading, 0.0)
            rows.append([*flatten(state), voltage])
    return np.array(rows)


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


def stepped_side_by_side(law: Law, params: Any, like: Any, points: Floats) -> Floats:
    """``stepped``, compiled for LANES points at once."""
    from valve_control.control import simd_layout

    count, width = points.shape
    blocks = -(-count // LANES)
    padded = np.resize(points, (blocks * LANES, width))
    before = np.ascontiguousarray(padded.reshape(blocks, LANES, width).transpose(0, 2, 1))
    after = np.empty((blocks, width * LANES))
    with explained(law.title):
        step = compile_function(law.module.step)
        parts = {"load": simd_layout.load, "store": simd_layout.store, "law_step": step}
        compile_function(step_blocks, parts, nogil=True)(
            p=params, like=StatePoint(like, 0.0), before=before.reshape(blocks, -1), after=after
        )
    return after.reshape(blocks, width, LANES).transpose(0, 2, 1).reshape(-1, width)[:count]


def linear_law(law: Law, params: Any, frozen: bool = False, steps: Steps = stepped) -> LinearLaw:
    """Linear form of ``law`` around rest at 0 V, from central differences of its step.

    ``frozen``: with its estimates at rest. Otherwise what adapts linearly around rest is part of it, such as
    the estimate of a constant disturbance; estimates of which products adapt are not. ``steps``: ``stepped``,
    or the same compiled. Raises LawError.
    """
    with explained(law.title):
        start = law.module.initial(params, Start(0.0, 0.0, 0.0, 0.0, 0.0))
        if frozen:
            params, start = law.linear(params, start)
        for _ in range(SETTLING):
            _, start, _ = law.module.step(params, start, 0.0, 0.0, 0.0)
    rest = np.array([*flatten(start), 0.0])  # the reading is the last entry
    size = len(rest)
    moved = np.eye(size)
    scale = np.full(size, SCALE)
    unmoved = float(steps(law, params, start, rest[None])[0, -1])
    up = steps(law, params, start, rest + scale[:, None] * moved)
    while np.any(far := ~(np.abs(up[:, -1] - unmoved) <= SMALL) & (scale >= SCALE * FINER**5)):
        scale[far] *= FINER
        up[far] = steps(law, params, start, rest + scale[far, None] * moved[far])
    down = steps(law, params, start, rest - scale[:, None] * moved)
    matrix = ((up - down) / (2.0 * scale[:, None])).T  # of (state, reading) to (next state, voltage)
    if not np.all(np.isfinite(matrix)):
        raise LawError(f"{law.title} gives NaN or infinity for small motions around rest")
    links = matrix != 0.0
    on_the_way = _reached(links, size - 1) & _reached(links.T, size - 1)
    kept = np.flatnonzero(on_the_way[:-1])
    return LinearLaw(matrix[np.ix_(kept, kept)], matrix[kept, -1], matrix[-1, kept], float(matrix[-1, -1]))


def _reached(links: npt.NDArray[np.bool_], start: int) -> npt.NDArray[np.bool_]:
    """Which entries a disturbance of entry ``start`` gets to; ``links[j, i]``: whether i moves j."""
    reached = links[:, start].copy()
    while True:
        more = reached | (links[:, :-1] @ reached[:-1])
        if np.array_equal(more, reached):
            return reached
        reached = more


def linear_valves(given: Sequence[Any]) -> LinearValves:
    """Linear form of plants with the Params ``given``, without friction; readings as in ``valve.delayed``."""
    plants = [registry.linear(p) for p in given]
    rows = np.array([[p.row0, p.row1, p.row2, p.row3] for p in plants])
    held = np.array([p.gain_scale * np.array(p.input) for p in plants])
    a = rows.copy()
    a[:, :, 0] -= held * np.array([[p.disturbance.flow_force] for p in plants])
    now, before = np.zeros((2, len(plants), 4))
    delay = np.array([p.lvdt.delay for p in plants])
    period = np.array([p.period for p in plants])
    late = delay.astype(np.int64)
    part = delay - late
    rest = 1.0 - part
    now[:, 0], now[:, 1] = rest**2 * (3.0 * part + rest), -(rest**2) * part * period
    before[:, 0], before[:, 1] = part**2 * (part + 3.0 * rest), part**2 * rest * period
    return LinearValves(a, held, now, before, late)


def undelayed(a: Floats, b: Floats) -> LinearValves:
    """One valve x⁺ = a·x + b·u whose reading is its first state."""
    first = np.eye(len(b))[:1]
    return LinearValves(a[None], b[None], first, np.zeros_like(first), np.zeros(1, dtype=np.int64))


def transitions(law: LinearLaw, valves: LinearValves) -> Floats:
    """Transition matrices (N×m×m) of the loops of ``law`` around each of N valves.

    States: m of the valve, before·x(k-1), the readings on their way through the dead time, the law's.
    """
    n, (count, m) = len(law.b), valves.b.shape
    longest = int(np.max(valves.late))
    own = m + 1 + longest
    reading = np.zeros((count, own))
    each = np.arange(count)
    fresh = np.concatenate([valves.now, np.ones((count, 1)), np.zeros((count, longest))], axis=1)
    reading[each] = np.where((valves.late == 0)[:, None], fresh, 0.0)
    delayed = np.flatnonzero(valves.late > 0)
    reading[delayed, m + valves.late[delayed]] = 1.0
    matrix = np.zeros((count, own + n, own + n))
    matrix[:, :m, :m] = valves.a
    matrix[:, :m, :own] += law.d * valves.b[:, :, None] * reading[:, None, :]
    matrix[:, :m, own:] = valves.b[:, :, None] * law.c
    matrix[:, m, :m] = valves.before
    if longest:
        matrix[:, m + 1, :own] = fresh
        for i in range(m + 2, own):
            matrix[:, i, i - 1] = 1.0
    matrix[:, own:, :own] = law.b[:, None] * reading[:, None, :]
    matrix[:, own:, own:] = law.a
    return matrix


def dominant_poles(law: LinearLaw, valves: LinearValves) -> Complexes:
    """The pole of largest modulus of the loop around each of N valves, shape (N)."""
    poles = np.linalg.eigvals(transitions(law, valves)).astype(complex)
    largest = np.argmax(np.abs(poles), axis=1)
    found: Complexes = poles[np.arange(len(poles)), largest]
    return found


def _states(a: Floats, b: Floats, z: Complexes) -> Complexes:
    """States of z·x = a·x + b (n) at the points ``z`` (F) of the z-plane, shape (F, n)."""
    pencil = z[:, None, None] * np.eye(len(b)) - a
    states = np.linalg.solve(pencil, np.broadcast_to(b[:, None], (len(z), len(b), 1)))
    return np.asarray(states[..., 0], dtype=complex)


def law_response(law: LinearLaw, z: Complexes) -> Complexes:
    """Voltage over reading at the points ``z`` (F) of the z-plane."""
    return _states(law.a, law.b, z) @ law.c + law.d


def valve_responses(valves: LinearValves, z: Complexes) -> tuple[Complexes, Complexes]:
    """Position and reading over voltage of N valves at the points ``z`` (F) of the z-plane, shapes (N, F)."""
    position, reading = np.empty((2, len(valves.b), len(z)), dtype=complex)
    for i, (a, b) in enumerate(zip(valves.a, valves.b, strict=True)):
        states = _states(a, b, z)
        position[i] = states[:, 0]
        reading[i] = (states @ valves.now[i] + states @ valves.before[i] / z) * z ** -float(valves.late[i])
    return position, reading
