# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A recorded run of the pure Python step, with which the C is compared bit for bit.

The law runs in a closed loop with the simulated valve, which has friction, flow force and a noisy LVDT:
strokes that saturate the amplifier, readings that are missing, and a takeover in motion with an offset that
fades out. The plant is driven by steps and sines up to the limit of its voltage. A law under the watch is
the supervisor's own, and the LVDT and the upper level fail in all the ways that it watches for.
"""

import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.laws.signals import Start
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.export.kinds import Kind
from valve_control.export.unit import Unit, in_c, leaves, numbers
from valve_control.parameter import defaults, updated

COLUMNS = ("event", "a", "b", "c", "d", "e", "result", "state")
COUNT = 3000  # samples
WATCHED = (3000, 12000)  # samples of a run under the watch, within which it should last
LASTING = 9.6  # s
VALVE_VALUES = {
    "friction.coulomb": 1.16,
    "friction.static_ratio": 1.25,
    "friction.stribeck_velocity": 0.017,
    "friction.presliding": 0.0033,
    "flow_force": 0.116,
    "lvdt.noise": 0.0056,
    "lvdt.resolution": 0.0037,
}
DEAD_TIME = 0.015  # s
STAMPED = 1.2  # s  from which on commands have time stamps
DRIFTING = 1.0003  # clock of the upper level over that of the samples
FADE = 0.98  # of a takeover's offset, for each sample


class Row(NamedTuple):
    """One call, with what it is given.

    init: reading, voltage, reference, its rate, velocity; step or hold of a law: command, reading, and offset
    or the voltage that is held; step of a plant: voltage, noise. Under the watch: sample with reading and
    samples that were left out before it; command; after, a command with the time since the one before; point
    of a trajectory with that time, and unpoint, its end; gone; reset; silence with its time.
    """

    event: str
    given: tuple[float, ...]
    result: float  # voltage, or reading before the step; 0.0 where there is none
    state: Any  # after it; of a law under the watch, the numbers


def digest(numbers: Sequence[float]) -> int:
    """A number of 64 bits that depends on each bit of ``numbers``: FNV-1a over words of doubles."""
    value = 0xCBF29CE484222325
    for word in struct.unpack(f"<{len(numbers)}Q", struct.pack(f"<{len(numbers)}d", *numbers)):
        value = ((value ^ word) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return value


def finite(numbers: Sequence[float]) -> bool:
    """Whether all are."""
    return all(math.isfinite(number) for number in numbers)


def run(unit: Unit, words: Mapping[str, int], count: int = COUNT, seed: int = 1) -> list[Row]:
    """Rows of a run, to the last one whose numbers are finite; ``words``: number of each word in C."""
    if unit.inner is not None:
        least, most = WATCHED
        return list(under_watch(unit, words, max(least, min(most, round(LASTING / unit.period))), seed))
    made = _law(unit, count, seed) if unit.is_law else _plant(unit, count, seed)
    rows = []
    try:
        for row in made:
            if not finite([row.result, *_numbers(row)]):
                break
            rows.append(row)
    except ArithmeticError:  # the law has produced NaN or infinity
        pass
    return rows


def _numbers(row: Row) -> list[float]:
    state: list[float] = row.state if isinstance(row.state, list) else [n for _, n in leaves(row.state)]
    return state


def command(k: int, period: float) -> float:
    """Command [V] at sample ``k``: steps, beyond what the voltage can do, and sines."""
    t = k * period
    height = 7.0 if int(t / 0.25) % 2 else -3.0
    return height if int(t / 1.0) % 2 == 0 else 1.5 * math.sin(2.0 * math.pi * 6.0 * t)


def swing(t: float) -> Motion:
    """Point of a trajectory at the time ``t`` [s]."""
    rate = 2.0 * math.pi * 3.0
    return Motion(
        2.0 * math.sin(rate * t), 2.0 * rate * math.cos(rate * t), -2.0 * rate**2 * math.sin(rate * t)
    )


def _law(unit: Unit, count: int, seed: int) -> Iterator[Row]:
    values = {**VALVE_VALUES, "sample_period": unit.period, "u_max": float(unit.params.u_max)}
    plant = build.valve_params(updated(VALVE, defaults(VALVE), values))
    module, p = unit.module, unit.params
    spool = valve.initial(plant)
    random = np.random.default_rng(seed)
    noise = random.standard_normal(count).tolist()
    lost = (random.random(count) < 0.05).tolist()
    reading = valve.read(plant, spool, noise[0])
    start = Start(reading, 0.0, reading, 0.0, 0.0)
    state, voltage, offset = module.initial(p, start), 0.0, 0.0
    yield Row("init", tuple(start), 0.0, state)
    for k in range(count):
        wanted = command(k, plant.period)
        reading = valve.read(plant, spool, noise[k])
        if k == 2 * count // 3:
            start = Start(reading, voltage, reading, spool.x.x1, spool.x.x1)
            state, offset = module.initial(p, start), 0.5
            yield Row("init", tuple(start), 0.0, state)
        if lost[k]:
            state = module.hold(p, state, wanted, reading, voltage)
            yield Row("hold", (wanted, reading, voltage), 0.0, state)
        else:
            voltage, state, _ = module.step(p, state, wanted, reading, offset)
            yield Row("step", (wanted, reading, offset), voltage, state)
        offset *= FADE
        spool = valve.step(plant, spool, voltage)


def _plant(unit: Unit, count: int, seed: int) -> Iterator[Row]:
    module, p = unit.module, unit.params
    state = unit.begin()
    noise = np.random.default_rng(seed).standard_normal(count).tolist()
    for k in range(count):
        voltage = 1.5 * command(k, unit.period)
        reading = module.read(p, state, noise[k])
        state = module.step(p, state, voltage)
        yield Row("step", (voltage, noise[k]), reading, state)


class Fault(NamedTuple):
    """What goes wrong in a run under the watch."""

    begin: float  # s
    samples: int
    what: str


FAULTS = (
    Fault(0.15, 3, "missing"),
    Fault(0.20, 4, "jump"),
    Fault(0.25, 2, "beyond"),
    Fault(0.30, 1, "late"),  # one reading after several that did not come
    Fault(0.40, 30, "missing"),
    Fault(0.75, 1, "gap"),  # longer than what is bridged
    Fault(1.10, 40, "jump"),
    Fault(1.50, 300, "trajectory"),
    Fault(1.90, 200, "trajectory"),
    Fault(1.65, 20, "set_back"),  # the clock of the trajectory
    Fault(2.05, 1, "no_trajectory"),
    Fault(2.30, 60, "beyond"),
    Fault(2.70, 200, "frozen"),
    Fault(3.10, 1, "silence"),
    Fault(3.40, 4, "not_finite_command"),
    Fault(3.45, 4, "large_command"),
    Fault(3.50, 700, "no_command"),
    Fault(4.30, 1, "gone"),
    Fault(4.60, 600, "flipped"),
    Fault(6.50, 400, "half"),
    Fault(7.02, 900, "dead"),
    Fault(7.50, 2, "jump"),
    Fault(7.00, 1, "reset"),
    Fault(8.00, 2, "reset"),
    Fault(8.00, 1600, "old"),  # readings that are late
)  # fmt: skip


COMMANDED = {"not_finite_command": math.nan, "large_command": 1e6, "old": 0.3}  # V  in place of the command
READ: dict[str, Callable[[float, int], float]] = {  # what becomes of a reading [V] at a sample, in this order
    "flipped": lambda reading, k: -reading,
    "half": lambda reading, k: 0.5 * reading,
    "dead": lambda reading, k: 0.0006 * (k % 3) - 10.0,
    "jump": lambda reading, k: reading + 3.0,
    "beyond": lambda reading, k: 1e3,
    "missing": lambda reading, k: math.nan,
}
CALLED: dict[str, tuple[str, tuple[float, ...], Callable[[Supervisor], object]]] = {
    "no_trajectory": ("unpoint", (), Supervisor.trajectory_gone),
    "gone": ("gone", (), Supervisor.command_gone),
    "reset": ("reset", (), Supervisor.reset),
    "silence": ("silence", (0.03,), lambda supervisor: supervisor.silence(0.03)),
}  # event of a fault, what it takes in, and the call
LEFT_OUT = {"late": 3, "gap": 50}  # samples before a reading
Event = tuple[str, tuple[float, ...], float]  # with what it takes in, and what it gives


def _sent(supervisor: Supervisor, now: set[str], k: int, period: float) -> Iterator[Event]:
    """What the upper level sends before sample ``k`` with the faults of ``now``."""
    t = k * period
    wanted = 0.4 * command(k, period) if t < 1.0 else command(k, period)
    for what in now & COMMANDED.keys():
        wanted = COMMANDED[what]
    times = (1.0 + t * DRIFTING, (0.5 + 0.4 * math.sin(k)) * period)
    if "no_command" not in now and t > STAMPED:
        supervisor.command(wanted, *times)
        yield "at", (wanted, *times), 0.0
    elif "no_command" not in now:
        supervisor.command(wanted)
        yield "command", (wanted,), 0.0
    if "trajectory" in now:
        backwards = 3.0 if "set_back" in now else 0.01 if k % 100 == 0 else 0.0
        point, stamp = swing(t), times[0] - backwards
        taken = supervisor.trajectory(point, stamp, times[1])
        yield "point", (*point, stamp, times[1]), float(taken)


def faulty(
    unit: Unit, count: int, seed: int, faults: Sequence[Fault] = FAULTS
) -> Iterator[tuple[str, tuple[float, ...], Supervisor, float]]:
    """Events of a run, what they take in, and the supervisor and the voltage [V] after each."""
    values = {**VALVE_VALUES, "sample_period": unit.period, "u_max": float(unit.params.law.u_max)}
    plant = build.valve_params(updated(VALVE, defaults(VALVE), values))
    supervisor = Supervisor()
    supervisor.apply(unit.values, unit.inner.params)
    spool = valve.initial(plant)
    random = np.random.default_rng(seed)
    noise = random.standard_normal(count).tolist()
    lost = (random.random(count) < 0.01).tolist()
    late = round(DEAD_TIME / plant.period)
    number, shown = 0, 0.0
    readings: list[float] = []
    for k in range(count):
        now = {f.what for f in faults if 0 <= k - round(f.begin / plant.period) < f.samples}
        for event, given, result in _sent(supervisor, now, k, plant.period) if k > 10 and k % 3 == 0 else ():
            yield event, given, supervisor, result
        for what, (event, given, call) in CALLED.items():
            if what in now:
                voltage = call(supervisor)
                yield event, given, supervisor, voltage if isinstance(voltage, float) else 0.0
        readings.append(valve.read(plant, spool, noise[k]))
        shown = shown if "frozen" in now else readings[max(0, k - late) if "old" in now else k]
        reading = shown
        for what, becomes in READ.items():
            reading = becomes(reading, k) if what in now else reading
        skipped = max((LEFT_OUT[what] for what in now & LEFT_OUT.keys()), default=int(lost[k]))
        number += 1 + skipped
        answer = supervisor.sample(reading, number)
        yield "sample", (reading, float(skipped)), supervisor, answer
        spool = valve.step(plant, spool, answer)


def under_watch(
    unit: Unit, words: Mapping[str, int], count: int, seed: int, faults: Sequence[Fault] = FAULTS
) -> Iterator[Row]:
    """Rows of a run of the supervisor, in which much goes wrong."""
    kind = Kind("record", unit.module.State)
    for event, given, supervisor, voltage in faulty(unit, count, seed, faults):
        yield Row(event, given, voltage, numbers(kind, in_c(unit.module, supervisor.memory), words))


def as_csv(rows: Sequence[Row]) -> str:
    """The rows as CSV text whose decimals give the same bits when they are read; the state as its digest."""
    lines = [",".join(COLUMNS)]
    for row in rows:
        given = [repr(number) for number in row.given] + ["0.0"] * (5 - len(row.given))
        lines.append(",".join([row.event, *given, repr(row.result), f"{digest(_numbers(row)):016x}"]))
    return "\n".join(lines) + "\n"
