"""A recorded run of the pure Python step, with which the C is compared bit for bit.

The law runs in a closed loop with the simulated valve, which has friction, flow force and a noisy LVDT:
strokes that saturate the amplifier, readings that are missing, and a takeover in motion with an offset that
fades out. The plant is driven by steps and sines up to the limit of its voltage.
"""

import math
import struct
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.export.unit import Unit, leaves
from valve_control.laws.signals import Start
from valve_control.parameter import defaults, updated
from valve_control.parameters import build
from valve_control.parameters.table import VALVE
from valve_control.plant import valve

COLUMNS = ("event", "a", "b", "c", "d", "e", "result", "state")
COUNT = 3000  # samples
VALVE_VALUES = {
    "friction.coulomb": 1.16,
    "friction.static_ratio": 1.25,
    "friction.stribeck_velocity": 0.017,
    "friction.presliding": 0.0033,
    "flow_force": 0.116,
    "lvdt.noise": 0.0056,
    "lvdt.resolution": 0.0037,
}
FADE = 0.98  # of a takeover's offset, for each sample


class Row(NamedTuple):
    """One call, with what it is given.

    init: reading, voltage, reference, its rate, velocity; step or hold of a law: command, reading, and offset
    or the voltage that is held; step of a plant: voltage, noise.
    """

    event: str
    given: tuple[float, ...]
    result: float  # voltage, or reading before the step; 0.0 where there is none
    state: Any  # after it


def digest(numbers: Sequence[float]) -> int:
    """A number of 64 bits that depends on each bit of ``numbers``: FNV-1a over words of doubles."""
    value = 0xCBF29CE484222325
    for word in struct.unpack(f"<{len(numbers)}Q", struct.pack(f"<{len(numbers)}d", *numbers)):
        value = ((value ^ word) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return value


def finite(numbers: Sequence[float]) -> bool:
    """Whether all are."""
    return all(math.isfinite(number) for number in numbers)


def run(unit: Unit, count: int = COUNT, seed: int = 1) -> list[Row]:
    """Rows of a run, to the last one whose numbers are finite."""
    made = _law(unit, count, seed) if unit.is_law else _plant(unit, count, seed)
    rows = []
    try:
        for row in made:
            if not finite([row.result, *(number for _, number in leaves(row.state))]):
                break
            rows.append(row)
    except ArithmeticError:  # the law has left the finite numbers
        pass
    return rows


def command(k: int, period: float) -> float:
    """Command [V] at sample ``k``: steps, beyond what the voltage can do, and sines."""
    t = k * period
    height = 7.0 if int(t / 0.25) % 2 else -3.0
    return height if int(t / 1.0) % 2 == 0 else 1.5 * math.sin(2.0 * math.pi * 6.0 * t)


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
    state = module.initial(p)
    noise = np.random.default_rng(seed).standard_normal(count).tolist()
    for k in range(count):
        voltage = 1.5 * command(k, unit.period)
        result = module.read(p, state, noise[k])
        state = module.step(p, state, voltage)
        yield Row("step", (voltage, noise[k]), result, state)


def as_csv(rows: Sequence[Row]) -> str:
    """The rows as CSV text whose decimals give the same bits when they are read; the state as its digest."""
    lines = [",".join(COLUMNS)]
    for row in rows:
        given = [repr(number) for number in row.given] + ["0.0"] * (5 - len(row.given))
        numbers = [number for _, number in leaves(row.state)]
        lines.append(",".join([row.event, *given, repr(row.result), f"{digest(numbers):016x}"]))
    return "\n".join(lines) + "\n"
