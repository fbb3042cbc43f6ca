"""Many valves at once, each with its own law, plant and noise: indices in bounded memory, or traces.

Valves go through one compiled loop in blocks of eight, which the compiler turns into SIMD: within a sample
every valve waits for its own divisions and square roots, eight of them wait together. Blocks are shared out
to threads. Every valve has the noise of its own seed, with the bits of numpy's generator as in
``offline.simulate``, so that its run is the same there and here, whatever block and number of threads.
"""

import os
import types
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import numpy.typing as npt

from valve_control.compiling import compile_function
from valve_control.laws.signals import Start
from valve_control.plant import valve
from valve_control.simulation import closed_loop

Array = npt.NDArray[np.float64]
Words = npt.NDArray[np.uint64]
Valves = npt.NDArray[np.int64]
Records = npt.NDArray[np.void]  # one row a valve, fields as in the NamedTuple, all float64
LANES = 8  # valves of a block: the doubles of one AVX-512 register
SPAN = 256  # samples of noise made at a time: they stay in the nearest cache


class Motion(NamedTuple):
    """State of a spool."""

    x: valve.Row  # position [V], velocity [V/s] and two inner states
    bristle: float  # -  deflection of the bristles over that of sliding
    time: float  # s


class Tally(NamedTuple):
    """Sums from which the indices come."""

    e_max: float  # V
    e_final: float  # V   largest of the last two seconds
    e_squares: float  # V²
    true_max: float  # V   of the true position
    true_squares: float  # V²
    u_squares: float  # V²
    change_squares: float  # V²  of the voltage from sample to sample
    saturated: float  # -   samples at ±u_max
    voltage: float  # V   of the sample before


class Work(NamedTuple):
    """What changes from sample to sample; the first six are handed over between the loops of a sample."""

    noise: float  # -  standard normal
    position: float  # V  that the LVDT sees, after its delay
    command: float  # V
    measurement: float  # V
    true_position: float  # V
    level: float  # V  of friction
    tally: Tally
    motion: Motion
    law: Any


# Where they stand in a block.
NOISE, POSITION, COMMAND, LEVEL = (
    LANES * Work._fields.index(name) for name in ("noise", "position", "command", "level")
)


class Lane(NamedTuple):
    """Everything about one valve."""

    work: Work
    law: Any
    valve: valve.Params


class Results(NamedTuple):
    """One entry per valve; NaN where a run did not stay finite."""

    e_M: Array  # V  (I2)
    e_F: Array  # V  (I3)
    e_rms: Array  # V  (I1)
    u_rms: Array  # V  (I4)
    c_u: Array  # -  (I5)
    true_e_M: Array  # V  of the true position
    true_e_rms: Array  # V
    saturated: Array  # -  share of the samples at ±u_max
    finite: npt.NDArray[np.bool_]


class Batch(NamedTuple):
    """What is run: one law on as many valves, N, as there are seeds.

    ``commands`` [V] of n samples: shape (n), the same for all valves, or (N, n), one row a valve. They go to
    the law as they are; ``offline.simulate`` clips them to command_limit before.
    """

    controller: str
    law_params: Records | tuple[Any, ...]  # N rows, or one for all valves
    valve_params: Records | valve.Params
    seeds: Sequence[int] | npt.NDArray[np.int64]  # of the LVDTs' noise
    commands: Array


def law_step(p: Any, s: Any, command: float, measurement: float, offset: float) -> Any:
    """Stands for the step of the law; replaced before the loop runs."""
    raise NotImplementedError


def law_initial(p: Any, start: Start) -> Any:
    """Stands for the beginning of the law."""
    raise NotImplementedError


def load(like: Any, block: Array, lane: int) -> Any:
    """Stands for ``lanes.load``."""
    raise NotImplementedError


def store(value: Any, block: Array, lane: int) -> None:
    """Stands for ``lanes.store``."""
    raise NotImplementedError


def fill(words: Words, noise: Array) -> None:
    """Stands for ``normal.fill``."""
    raise NotImplementedError


def begin(like: Lane, block: Array, noise: Array) -> None:
    """Put the valves of ``block``, whose parameters are there, at rest and the laws at their readings."""
    for j in range(LANES):
        lane = load(like, block, j)
        first = valve.reading(lane.valve.lvdt, 0.0, noise[j, 0])
        law = law_initial(lane.law, Start(first, 0.0, first, 0.0, 0.0))
        motion = Motion(valve.Row(0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
        tally = Tally(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        store(Work(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, tally, motion, law), block, j)


def sample(lane: Lane, changed: float, final: float) -> Work:
    """One sample of one valve: read, step, count, move.

    ``changed``: 0.0 at the first sample, else 1.0; ``final``: 1.0 within the last two seconds, else 0.0.
    """
    w, p = lane.work, lane.valve
    measurement = valve.reading(p.lvdt, w.position, w.noise)
    voltage, law, _ = law_step(lane.law, w.law, w.command, measurement, 0.0)
    error = abs(measurement - w.command)
    true_error = abs(w.motion.x.x0 - w.command)
    change = changed * (voltage - w.tally.voltage)
    t = w.tally
    tally = Tally(
        max(t.e_max, error),
        max(t.e_final, final * error),
        t.e_squares + error * error,
        max(t.true_max, true_error),
        t.true_squares + true_error * true_error,
        t.u_squares + voltage * voltage,
        t.change_squares + change * change,
        t.saturated + (1.0 if abs(voltage) >= p.u_max else 0.0),
        voltage,
    )
    x, bristle = valve.move(p, w.motion.x, w.motion.bristle, w.motion.time, w.level, voltage)
    motion = Motion(x, bristle, w.motion.time + p.period)
    return Work(w.noise, w.position, w.command, measurement, w.motion.x.x0, w.level, tally, motion, law)


def run_block(
    like: Lane,
    block: Array,
    words: Words,
    noise: Array,
    commands: Array,
    stride: int,
    valves: Valves,
    history: Array,
    last_begin: int,
    traces: Array,
) -> None:
    """Run the ``valves`` of one block, whose parameters are in ``block``.

    ``words`` (LANES×4): generators, which fill ``noise`` (LANES×SPAN) again and again; ``commands`` [V]:
    those of valve i begin at i·``stride``; ``history`` (LANES×m×2): rings as in ``valve.State``, for delayed
    LVDTs; ``last_begin``: sample at which the last two seconds begin; ``traces`` (N×n×3, or 0×n×3 for none)
    takes position, measurement and voltage [V], and has as many samples as the run.
    """
    record = traces.shape[0] > 0
    length = history.shape[1]
    for k in range(traces.shape[1]):
        i = k % SPAN
        if i == 0:
            fill(words, noise)
        if k == 0:
            begin(like, block, noise)
        for j in range(LANES):
            lane = load(like, block, j)
            position = lane.work.motion.x.x0
            if lane.valve.lvdt.delay > 0.0:
                valve.remember(history[j], k % length, lane.work.motion.x, lane.valve.period)
                position = valve.delayed(lane.valve.lvdt.delay, history[j], k % length)
            level = 0.0
            if lane.valve.disturbance.coulomb > 0.0:
                level = valve.friction_level(lane.valve.disturbance, lane.work.motion.x.x1)
            block[NOISE + j] = noise[j, i]
            block[POSITION + j] = position
            block[COMMAND + j] = commands[valves[j] * stride + k]
            block[LEVEL + j] = level
        changed = 1.0 if k > 0 else 0.0
        final = 1.0 if k >= last_begin else 0.0
        for j in range(LANES):
            store(sample(load(like, block, j), changed, final), block, j)
        if record:
            for j in range(LANES):
                lane = load(like, block, j)
                traces[valves[j], k, 0] = lane.work.true_position
                traces[valves[j], k, 1] = lane.work.measurement
                traces[valves[j], k, 2] = lane.work.tally.voltage


@cache
def _compiled(law: types.ModuleType) -> Callable[..., None]:
    from valve_control.simulation import lanes, normal

    access = {"load": lanes.load, "store": lanes.store}
    start = compile_function(begin, {**access, "law_initial": compile_function(law.initial)})
    counted = compile_function(sample, {"law_step": compile_function(law.step)})
    return compile_function(
        run_block,
        {**access, "begin": start, "fill": compile_function(normal.fill), "sample": counted},
        nogil=True,
    )


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


def _rows(name: str, params: Records | tuple[Any, ...], like: Any, count: int) -> Array:
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


class Job(NamedTuple):
    """A batch made ready."""

    like: Lane
    width: int  # numbers of a lane
    law: types.ModuleType
    law_rows: Array
    valve_rows: Array
    seeds: Valves
    words: Words  # N×4  generators
    delays: Array  # periods, of the LVDTs
    commands: Array  # V  one after the other
    stride: int  # between the commands of one valve and the next
    samples: int
    period: float  # s


def _commands(batch: Batch, count: int) -> Array:
    commands = np.asarray(batch.commands, dtype=np.float64)
    if commands.ndim not in (1, 2) or commands.shape[:-1] not in ((), (count,)) or commands.size == 0:
        raise ValueError(f"commands of {count} valves have shape (n) or ({count}, n), not {commands.shape}")
    if not np.all(np.isfinite(commands)):
        raise ValueError("commands must be finite")
    return commands


def _ready(batch: Batch) -> Job:
    from valve_control.simulation.normal import states_of

    if batch.controller not in closed_loop.LAWS:
        raise ValueError(
            f"there is no controller '{batch.controller}'; there are {', '.join(closed_loop.LAWS)}"
        )
    law = closed_loop.LAWS[batch.controller]
    seeds = np.asarray(batch.seeds)
    if seeds.ndim != 1 or len(seeds) == 0 or seeds.dtype.kind not in "iu" or np.any(seeds < 0):
        raise ValueError("seeds must be whole numbers, none below 0, one for each of at least one valve")
    seeds = seeds.astype(np.int64)
    count = len(seeds)
    commands = _commands(batch, count)
    samples = commands.shape[-1]
    like = Lane(
        Work(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, template(Tally), template(Motion), template(law.State)),
        template(law.Params),
        template(valve.Params),
    )
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
    return Job(
        like,
        width,
        law,
        law_rows,
        valve_rows,
        seeds,
        states_of(seeds),
        plants["lvdt"]["delay"],
        commands.ravel(),
        0 if commands.ndim == 1 else samples,
        samples,
        float(periods[0]),
    )


def _run_lanes(job: Job, start: int, traces: Array) -> Array:
    """Tallies of the valves from ``start`` on, at most LANES; the last one fills up a last block."""
    valves = np.minimum(np.arange(start, start + LANES), len(job.seeds) - 1)
    rows = np.concatenate([job.law_rows[valves], job.valve_rows[valves]], axis=1)
    block = np.zeros((job.width, LANES))
    block[job.width - rows.shape[1] :] = rows.T
    _compiled(job.law)(
        job.like,
        block.ravel(),
        job.words[valves],
        np.empty((LANES, SPAN)),
        job.commands,
        job.stride,
        valves,
        np.zeros((LANES, int(np.max(job.delays[valves])) + 2, 2)),
        job.samples - max(1, min(job.samples, round(2.0 / job.period) + 1)),
        traces,
    )
    at = Work._fields.index("tally")
    return block[at : at + len(Tally._fields)].T[: len(job.seeds) - start]


def _results(tallies: Array, samples: int) -> Results:
    """Indices from sums."""
    t = Tally(*tallies.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        finite = np.isfinite(t.e_squares + t.true_squares + t.u_squares)
        u_rms = np.sqrt(t.u_squares / samples)
        change = np.sqrt(t.change_squares / max(1, samples - 1))
        numbers = (
            t.e_max,
            t.e_final,
            np.sqrt(t.e_squares / samples),
            u_rms,
            np.where(u_rms == 0.0, 0.0, change / u_rms),
            t.true_max,
            np.sqrt(t.true_squares / samples),
            t.saturated / samples,
        )
    return Results._make([*(np.where(finite, column, np.nan) for column in numbers), finite])


def simulate(batch: Batch, threads: int | None = None, traces: Array | None = None) -> Results:
    """Run every valve of ``batch`` on ``threads`` (all cores).

    ``traces`` (N×n×3) takes position, measurement and voltage [V] of each valve; without it memory does not
    grow with the length of a run. Ctrl-C ends it as soon as the blocks that are running are through. Raises
    ValueError for a batch that does not fit together.
    """
    job = _ready(batch)
    if threads is not None and threads < 1:
        raise ValueError(f"threads is {threads}; it must be at least 1")
    shape = (len(job.seeds), job.samples, 3)
    if traces is None:
        traces = np.empty((0, job.samples, 3))
    elif traces.shape != shape or traces.dtype != np.float64 or not traces.flags.c_contiguous:
        raise ValueError(f"traces must be a C-contiguous array of float64 with shape {shape}")
    # One sample in this thread, because Ctrl-C reaches no other: the first time it compiles for a while.
    _run_lanes(job, 0, np.empty((0, 1, 3)))
    pool = ThreadPoolExecutor(threads or len(os.sched_getaffinity(0)))
    try:
        starts = range(0, len(job.seeds), LANES)
        tallies = np.concatenate(list(pool.map(lambda start: _run_lanes(job, start, traces), starts)))
    finally:
        pool.shutdown(cancel_futures=True)
    return _results(tallies, job.samples)
