# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates many valves at once, each with its own law, plant and noise; gives indices or whole signals.

Valves go through one compiled loop in blocks of eight, which the compiler turns into SIMD instructions: most
of a sample is waiting for divisions and square roots, and eight valves wait together. Threads share the
blocks. Every valve has the noise of its own seed, with the bits of numpy's generator as in
``offline.simulate``, so that its run is the same there and here, whatever block and number of threads. Valves
of another plant than the linear one go through ``closed_loop.run_loop`` one by one.
"""

import functools
import os
import types
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control import closed_loop
from valve_control.control.compiling import LANES, compile_function, explained
from valve_control.control.laws import linearisation
from valve_control.control.laws.places import law_initial
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.linear import linear_loop
from valve_control.control.linear.linear_loop import load, store
from valve_control.control.plant import registry, sensor, valve
from valve_control.control.plant.plant import Plant
from valve_control.control.simulation import measures, offline
from valve_control.control.simulation.measures import Results, Tally

Valves = npt.NDArray[np.int64]
Records = npt.NDArray[np.void]  # one row a valve, fields as in the NamedTuple, all float64


class SpoolState(NamedTuple):
    """Mechanical state of one spool."""

    x: valve.Row  # position [V], velocity [V/s] and two inner states
    bristle: float  # -  deflection of the bristles over that of sliding
    time: float  # s


class Work(NamedTuple):
    """What changes from sample to sample; the first eight are passed between the loops within a sample."""

    noise: float  # -  standard normal
    position: float  # V  that the LVDT sees, after its delay
    command: float  # V  of the upper level
    led: float  # V  as the law gets it
    measurement: float  # V
    true_position: float  # V
    voltage: float  # V
    level: float  # V  of friction
    tally: Tally
    motion: SpoolState
    law: Any


HANDED_OVER = (0.0,) * 8  # the numbers at the beginning of Work
# Where they stand in a block.
NOISE, POSITION, COMMAND, LED, LEVEL = (
    LANES * Work._fields.index(name) for name in ("noise", "position", "command", "led", "level")
)


class Lane(NamedTuple):
    """Parameters and state of one valve, which takes one lane of a SIMD block."""

    work: Work
    law: Any
    valve: valve.Params


class Batch(NamedTuple):
    """What is simulated: one law on as many valves, N, as there are seeds.

    ``commands`` [V] of n samples: shape (n), the same for all valves, or (N, n), one row a valve. They go to
    the law as they are; ``offline.simulate`` clips them to command_limit before.
    """

    controller: str
    law_params: Records | tuple[Any, ...]  # N rows, or one for all valves; of ``linearisation.behind``, too
    valve_params: Records | Any  # N rows, or one for all: Params of any plant
    seeds: Sequence[int] | npt.NDArray[np.int64]  # of the LVDTs' noise
    commands: Floats
    led: Floats | None = None  # V, of the same shape: with the lead of ``command_lead``; None: ``commands``


def one_sample(p: Any, source: Any, law: Any, plant: Any, measure: Any, given: float, noise: float) -> Any:
    """Placeholder for ``closed_loop.sample``."""
    raise NotImplementedError


def read_delayed(p: valve.Params, position: float, noise: float) -> float:
    """LVDT reading [V] of a ``position`` [V] for which the LVDT's delay is known."""
    return sensor.reading(p.lvdt, position, noise)


def counted(p: measures.Now, tally: Tally, now: closed_loop.Sample, position: float) -> tuple[Tally, bool]:
    """Update the measures with this sample; ``p`` has what ``now`` lacks."""
    here = measures.Now(p.command, now.reading, p.position, now.voltage, p.first, p.final, p.u_max)
    return measures.count(tally, here), False


def begin(like: Lane, block: Floats, noise: Floats) -> None:
    """Put the valves of ``block`` at rest and start their laws from the first readings."""
    for j in range(LANES):
        lane = load(like, block, j)
        first = sensor.reading(lane.valve.lvdt, 0.0, noise[j, 0])
        law = law_initial(lane.law, Start(first, 0.0, first, 0.0, 0.0))
        motion = SpoolState(valve.Row(0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
        store(Work(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, like.work.tally, motion, law), block, j)


def sample(lane: Lane, first: bool, final: bool) -> Work:
    """Compute one sample of one valve: read, step the law, measure, move the spool.

    ``first``: at the first sample; ``final``: within the last two seconds.
    """
    w, p = lane.work, lane.valve
    at = measures.Now(w.command, 0.0, w.motion.x.x0, 0.0, first, final, p.u_max)
    parts = closed_loop.Parts(0.0, lane.law, p, at)
    now, _, law, tally, _ = one_sample(parts, 0.0, w.law, w.position, w.tally, w.led, w.noise)
    x, bristle = valve.move(p, w.motion.x, w.motion.bristle, w.motion.time, w.level, now.voltage)
    return Work(
        w.noise, w.position, w.command, w.led, now.reading, w.motion.x.x0, now.voltage, w.level,
        tally, SpoolState(x, bristle, w.motion.time + p.period), law,
    )  # fmt: skip


def run_block(
    like: Lane,
    block: Floats,
    noise: Floats,
    commands: Floats,
    led: Floats,
    stride: int,
    valves: Valves,
    history: Floats,
    last_begin: int,
    traces: Floats,
) -> None:
    """Run the ``valves`` of one block, whose parameters are in ``block``.

    ``noise`` (LANES×n): standard normal numbers; ``commands`` and ``led`` [V]: those of valve i begin at
    i·``stride``; ``history`` (LANES×m×2): rings as in ``valve.State``, for delayed LVDTs; ``last_begin``:
    sample at which the last two seconds begin; ``traces`` (N×n×3, or 0×n×3 for none) receives position,
    measurement and voltage [V], and has as many samples as the run. Arrays that come in records would make a
    sample 5 to 10 % slower.
    """
    record = traces.shape[0] > 0
    length = history.shape[1]
    begin(like, block, noise)
    for k in range(traces.shape[1]):
        for j in range(LANES):
            lane = load(like, block, j)
            position = lane.work.motion.x.x0
            if lane.valve.lvdt.delay > 0.0:
                valve.remember(history[j], k % length, lane.work.motion.x, lane.valve.period)
                position = valve.delayed(lane.valve.lvdt.delay, history[j], k % length)
            level = 0.0
            if lane.valve.disturbance.coulomb > 0.0:
                level = valve.friction_level(lane.valve.disturbance, lane.work.motion.x.x1)
            block[NOISE + j] = noise[j, k]
            block[POSITION + j] = position
            block[COMMAND + j] = commands[valves[j] * stride + k]
            block[LED + j] = led[valves[j] * stride + k]
            block[LEVEL + j] = level
        first, final = k == 0, k >= last_begin
        for j in range(LANES):
            store(sample(load(like, block, j), first, final), block, j)
        if record:
            for j in range(LANES):
                lane = load(like, block, j)
                traces[valves[j], k, 0] = lane.work.true_position
                traces[valves[j], k, 1] = lane.work.measurement
                traces[valves[j], k, 2] = lane.work.voltage


def _compiled(initial: Any, step: Any) -> Callable[..., None]:
    from valve_control.control import simd_layout

    access = {"load": simd_layout.load, "store": simd_layout.store}
    start = compile_function(begin, {**access, "law_initial": compile_function(initial)})
    places = (closed_loop.command_given, read_delayed, step, counted)
    parts = dict(zip(closed_loop.PLACES, map(compile_function, places), strict=True))
    one = compile_function(sample, {"one_sample": compile_function(closed_loop.sample, parts)})
    return compile_function(run_block, {**access, "begin": start, "sample": one}, nogil=True)


@functools.lru_cache(maxsize=10_000)  # a search runs the same valves, with the same seeds, again and again
def _beginning(seed: int) -> Any:
    """State of numpy's generator ``default_rng(seed)`` before its first number."""
    return np.random.PCG64(seed).state


def _noise(seeds: Valves, samples: int) -> Floats:
    """Standard normal numbers (seeds×samples), each row with the bits of ``default_rng(seed)``."""
    noise, bits = np.empty((len(seeds), samples)), np.random.PCG64(0)
    generator = np.random.Generator(bits)
    for row, seed in zip(noise, seeds.tolist(), strict=True):
        bits.state = _beginning(seed)
        generator.standard_normal(out=row)
    return noise


@functools.cache
def template(kind: type) -> Any:
    """A NamedTuple of type ``kind`` with 0.0 in every field, nested ones too."""
    if kind is float:
        return 0.0
    return kind(*(template(part) for part in get_type_hints(kind).values()))


def _dtype_of(value: Any) -> Any:
    if not isinstance(value, tuple):
        return np.float64
    names: tuple[str, ...] = value._fields  # type: ignore[attr-defined]
    return np.dtype([(name, _dtype_of(part)) for name, part in zip(names, value, strict=True)])


def records(params: Sequence[tuple[Any, ...]]) -> Records:
    """Record array, one row per NamedTuple; columns can be changed as ``rows["gamma"]["a1"] *= 2.0``."""
    made: Records = np.array(params, dtype=_dtype_of(params[0]))
    return made


def _rows(name: str, params: Records | tuple[Any, ...], like: Any, count: int) -> Floats:
    """Numbers of ``params``, one row per valve, of the fields of ``like``."""
    rows = params if isinstance(params, np.ndarray) else records([params])
    kind = type(like)
    if rows.dtype != _dtype_of(like) or rows.ndim != 1:
        raise ValueError(
            f"{name} must be {kind.__module__}.{kind.__name__}, or one row of batch.records a valve"
        )
    if len(rows) not in (1, count):
        raise ValueError(f"a batch of {count} valves needs parameters of 1 or {count}, not of {len(rows)}")
    flat = np.ascontiguousarray(rows).view(np.float64).reshape(len(rows), -1)
    return np.broadcast_to(flat, (count, flat.shape[1]))


def _is(params: Any, like: tuple[Any, ...]) -> bool:
    """Whether ``params`` are of the kind of ``like``, or rows of it."""
    rows = isinstance(params, np.ndarray) and params.dtype == _dtype_of(like)
    return rows or isinstance(params, type(like))


def _plant(params: Any) -> Plant:
    """The plant whose Params, or rows of them, ``params`` are; the linear one if they are none."""
    plants = (plant for plant in registry.PLANTS.values() if _is(params, template(plant.module.Params)))
    return next(plants, registry.PLANTS["linear"])


def _law(batch: Batch) -> tuple[types.ModuleType, Any]:
    """Steps of the law, and its Params with 0.0 everywhere; both with the curve behind it if it has one."""
    module, params = LAWS[batch.controller].module, batch.law_params
    alone, curve = template(LAWS[batch.controller].module.Params), template(linearisation.Curve)
    wide = linearisation.Params(alone, curve, curve, 0.0, 0.0)
    return (linearisation.around(module), wide) if _is(params, wide) else (module, alone)


class Prepared(NamedTuple):
    """A batch that is checked and laid out for the compiled loop."""

    like: Lane
    plant: Plant
    width: int  # numbers of a lane
    law: types.ModuleType
    law_rows: Floats
    valve_rows: Floats
    seeds: Valves
    delays: Floats  # periods, of the LVDTs of linear valves
    commands: Floats  # V  one after the other
    led: Floats  # V  likewise
    stride: int  # between the commands of one valve and the next
    samples: int
    last_begin: int  # sample at which the last two seconds begin


def _commands(given: Floats, count: int) -> Floats:
    commands = np.asarray(given, dtype=np.float64)
    if commands.ndim not in (1, 2) or commands.shape[:-1] not in ((), (count,)) or commands.size == 0:
        raise ValueError(f"commands of {count} valves have shape (n) or ({count}, n), not {commands.shape}")
    return commands


def _prepared(batch: Batch) -> Prepared:
    law, like_law = _law(batch)
    seeds = np.asarray(batch.seeds, dtype=np.int64)
    count = len(seeds)
    commands = _commands(batch.commands, count)
    led = commands if batch.led is None else _commands(batch.led, count)
    if led.shape != commands.shape:
        raise ValueError(f"commands have shape {commands.shape}, with their lead {led.shape}")
    samples = commands.shape[-1]
    states = (template(Tally), template(SpoolState), template(law.State))
    plant = _plant(batch.valve_params)
    like = Lane(Work._make([*HANDED_OVER, *states]), like_law, template(plant.module.Params))
    law_rows = _rows("law_params", batch.law_params, like.law, count)
    valve_rows = _rows("valve_params", batch.valve_params, like.valve, count)
    laws = law_rows.view(_dtype_of(like.law))[:, 0]
    plants = valve_rows.view(_dtype_of(like.valve))[:, 0]
    periods = np.unique(plants["period"])
    if len(periods) != 1:
        raise ValueError(f"the valves of a batch have one sample period, not {len(periods)}")
    for name in {"period", "u_max"} & set(like.law._fields):
        if np.any(laws[name] != plants[name]):
            raise ValueError(f"{name} differs between law and valve")
    width = _dtype_of(like).itemsize // 8
    return Prepared(
        like=like,
        plant=plant,
        width=width,
        law=law,
        law_rows=law_rows,
        valve_rows=valve_rows,
        seeds=seeds,
        delays=plants["lvdt"]["delay"] if plant.module is valve else np.zeros(count),
        commands=commands.ravel(),
        led=led.ravel(),
        stride=0 if commands.ndim == 1 else samples,
        samples=samples,
        last_begin=samples - max(1, min(samples, round(2.0 / float(periods[0])) + 1)),
    )


def _run_lanes(ready: Prepared, start: int, traces: Floats) -> Floats:
    """Tallies of up to LANES valves from ``start`` on; a block with fewer repeats the last valve."""
    valves = np.minimum(np.arange(start, start + LANES), len(ready.seeds) - 1)
    if ready.plant.module is not valve:
        return _run_singly(ready, np.unique(valves), traces)
    rows = np.concatenate([ready.law_rows[valves], ready.valve_rows[valves]], axis=1)
    block = np.zeros((ready.width, LANES))
    block[ready.width - rows.shape[1] :] = rows.T
    _compiled(ready.law.initial, ready.law.step)(
        like=ready.like,
        block=block.ravel(),
        noise=_noise(ready.seeds[valves], traces.shape[1]),
        commands=ready.commands,
        led=ready.led,
        stride=ready.stride,
        valves=valves,
        history=np.zeros((LANES, int(np.max(ready.delays[valves])) + 2, 2)),
        last_begin=ready.last_begin,
        traces=traces,
    )
    at = Work._fields.index("tally")
    return block[at : at + len(Tally._fields)].T[: len(ready.seeds) - start]


def _run_singly(ready: Prepared, valves: Valves, traces: Floats) -> Floats:
    """Tallies of ``valves``, whose plant has no loop over several at once."""
    samples, tallies = traces.shape[1], []
    for i in valves.tolist():
        one = slice(i * ready.stride, i * ready.stride + samples)
        law = linear_loop.unflatten(ready.like.law, ready.law_rows[i].tolist())
        plant = linear_loop.unflatten(ready.like.valve, ready.valve_rows[i].tolist())
        signals = traces[i] if len(traces) else np.empty((samples, len(closed_loop.SIGNALS)))
        (noise,) = _noise(ready.seeds[i : i + 1], samples)
        closed_loop.run_valve(
            ready.law,
            closed_loop.parts(law, plant),
            offline.at_rest(ready.law, law, plant, float(noise[0])),
            ready.led[one],
            noise,
            signals,
            np.empty((0, len(ready.law.Terms._fields))),
        )
        tally = compile_function(measures.tallied, nogil=True)(
            ready.commands[one], signals, ready.last_begin, plant.u_max
        )
        tallies.append(linear_loop.flatten(tally))
    return np.array(tallies)


def simulate(batch: Batch, threads: int | None = None, traces: Floats | None = None) -> Results:
    """Simulate every valve of ``batch`` on ``threads`` threads (default: all cores).

    ``traces`` (N×n×3) takes position, measurement and voltage [V] of each valve; without it a run keeps no
    more than the noise of the LANES valves of each thread. Ctrl-C ends it as soon as the blocks that are
    running are through. Raises ValueError for a batch that does not fit together.
    """
    ready = _prepared(batch)
    shape = (len(ready.seeds), ready.samples, 3)
    if traces is None:
        traces = np.empty((0, ready.samples, 3))
    elif traces.shape != shape or traces.dtype != np.float64 or not traces.flags.c_contiguous:
        raise ValueError(f"traces must be a C-contiguous array of float64 with shape {shape}")
    # One sample in this thread, because Ctrl-C reaches no other: the first time it compiles for a while.
    with explained(LAWS[batch.controller].title):
        _run_lanes(ready, 0, np.empty((0, 1, 3)))
    pool = ThreadPoolExecutor(threads or len(os.sched_getaffinity(0)))
    try:
        starts = range(0, len(ready.seeds), LANES)
        tallies = np.concatenate(list(pool.map(lambda start: _run_lanes(ready, start, traces), starts)))
    finally:
        pool.shutdown(cancel_futures=True)
    return measures.results(tallies.T, ready.samples)
