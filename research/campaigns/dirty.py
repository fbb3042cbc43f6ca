# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Faults with noise and hum, offline: the supervisor sample by sample around a simulated valve.

Each fault of LVDT, valve and supply comes at rest, in motion and from the start, with noise of 0, 1 and 10
counts of the converter or with a hum, under each law, shipped and tuned. A row tells the worst of them: time
until 0 V or a report, volt-seconds until then, how far the true spool went beyond the command, and for how
long more than ``lvdt.disturbance`` stood at a stretch.
"""

import argparse
import itertools
import math
import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision.record import Mode
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import Values, defaults, number, updated

PERIOD = 0.001  # s
BEGIN = 0.7  # s  of the fault, unless it is there from the start
OBSERVED = 3.0  # s  from then on
MAINS = 50.0  # Hz
HUM = 0.02  # V
BITS = {12: 20.0 / 2**12, 16: 20.0 / 2**16}  # V  steps of converters over ±10 V
NOISES = ("0", "1", "10", "hum")  # counts, or hum
NAMED = ("lvdt_doubted", "lvdt_noise", "lvdt_mains", "lvdt_hum", "lvdt_gain", "spool_sticks")  # beside 0 V
WHEN = ("start", "rest", "motion")
TUNED = tuple(
    f"{valve_name}_{law}"
    for valve_name in ("d3fxe", "d3fxe_experiment")
    for law in ("arc", "oarc", "dcarc", "pid")
)


class Fault(NamedTuple):
    """Where the spool cannot move, the voltage that reaches it, and the reading instead of the true one."""

    held: bool = False
    powered: bool = True
    reading: Callable[[float, float], float] = lambda true, last: (
        true
    )  # of the true and the last sound one [V]


FAULTS = {
    "none": Fault(),
    "dead at -10 V": Fault(reading=lambda true, last: -10.0),
    "dead at -9 V": Fault(reading=lambda true, last: -9.0),
    "dead at 0 V": Fault(reading=lambda true, last: 0.0),
    "dead where it is": Fault(reading=lambda true, last: last),
    "stuck": Fault(held=True),
    "supply off": Fault(powered=False),
    "flipped": Fault(reading=lambda true, last: -true),
    "half": Fault(reading=lambda true, last: 0.5 * true),
    "flat": Fault(reading=lambda true, last: 0.05 * true),
    "offset of 3 V": Fault(reading=lambda true, last: true + 3.0),
}


class Outcome(NamedTuple):
    """Of one fault."""

    reaction: float  # s  until 0 V or a report, inf: never
    impulse: float  # V·s  until then, beyond the voltage that holds the command
    beyond: float  # V  of the true spool beyond neutral and command
    standing: float  # s  longest stretch above lvdt.disturbance
    stops: int
    conditions: str


def setting(name: str) -> tuple[Values, Values]:
    """Values of controller and valve of a law, or of a file of config/tuned."""
    folder = files.config_folder()
    plant = "d3fxe_experiment" if name.startswith("d3fxe_experiment") else "d3fxe"
    own = files.load(str(folder / f"{plant}.yaml"))
    gains: Values = {"controller": name}
    if name in TUNED:
        gains = dict(files.load(str(folder / "tuned" / f"{name}.yaml"))["controller"])
    return (
        updated(CONTROLLER, defaults(CONTROLLER), {**own.get("controller", {}), **gains}),
        updated(VALVE, defaults(VALVE), own["valve_simulator"]),
    )


def run(
    name: str,
    fault: Fault,
    noise: str,
    when: str,
    bits: int,
    valve_changes: Values | None = None,
    wanted: float = 1.0,
) -> Iterator[tuple[float, float, float, Supervisor]]:
    """Command, voltage and true position [V] of each sample from the fault on, and the supervisor."""
    values, plant = setting(name)
    plant = updated(VALVE, plant, valve_changes or {})
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    p = build.valve_params(plant)
    s, random, last = valve.initial(p), np.random.default_rng(1), 0.0
    counts = 0 if noise == "hum" else int(noise)
    begin = 0 if when == "start" else round(BEGIN / PERIOD)
    for k in range(begin + round(OBSERVED / PERIOD)):
        command = wanted
        if when == "motion":
            command = 2.0 * math.sin(2.0 * math.pi * 1.5 * k * PERIOD)
        reading = valve.read(p, s, float(random.standard_normal()))
        faulty = k >= begin
        if faulty:
            reading = fault.reading(reading, last) + BITS[bits] * float(random.integers(-counts, counts + 1))
            if noise == "hum":
                reading += HUM * math.sin(2.0 * math.pi * MAINS * k * PERIOD)
        else:
            last = reading
        reading = BITS[bits] * math.floor(reading / BITS[bits] + 0.5)
        supervisor.command(command)
        voltage = supervisor.sample(reading, k + 1)
        if faulty:
            yield command, voltage, s.x.x0, supervisor
        if not (faulty and fault.held):
            s = valve.step(p, s, voltage if fault.powered or not faulty else 0.0)


def outcome(samples: Iterator[tuple[float, float, float, Supervisor]]) -> Outcome:
    """What became of one run."""
    reaction, impulse, beyond, stretch, standing = math.inf, 0.0, 0.0, 0, 0
    low = high = 0.0
    said: dict[str, None] = {}
    supervisor = None
    for k, (command, voltage, position, supervisor) in enumerate(samples):
        low, high = min(low, command), max(high, command)
        beyond = max(beyond, low - position, position - high)
        limit = number(supervisor.values, "lvdt.disturbance")
        stretch = stretch + 1 if abs(voltage) > limit else 0
        standing = max(standing, stretch)
        said.update(dict.fromkeys(supervisor.conditions))
        named = [one for one in supervisor.conditions if one in NAMED]
        if math.isinf(reaction) and (supervisor.mode is Mode.SAFE or named):
            reaction = k * PERIOD
        if math.isinf(reaction):
            impulse += PERIOD * max(0.0, abs(voltage) - 1.1 * abs(command))
    assert supervisor is not None
    stops = supervisor.counts["safe_stops"]
    return Outcome(reaction, impulse, beyond, standing * PERIOD, stops, " ".join(said))


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--law", action="append", help="instead of all")
    parser.add_argument("--fault", action="append", help="instead of all")
    parser.add_argument("--bits", action="append", type=int, help="of the converter, instead of 12 and 16")
    parser.add_argument("--all", action="store_true", help="one row for each run")
    chosen = parser.parse_args()
    print(f"{'fault':18}{'law':26}{'reaction':>9}{'V·s':>8}{'beyond':>8}{'> D for':>8}{'stops':>6}")
    for fault, law in itertools.product(chosen.fault or FAULTS, chosen.law or (*LAWS, *TUNED)):
        rows = {
            (noise, when, bits): outcome(run(law, FAULTS[fault], noise, when, bits))
            for noise, when, bits in itertools.product(NOISES, WHEN, chosen.bits or BITS)
        }
        shown = list(rows.items()) if chosen.all else [(None, worst(list(rows.values())))]
        for case, row in shown:
            words = " ".join(map(str, case)) + "  " + row.conditions if case else ""
            print(
                f"{fault:18}{law:26}{row.reaction:9.3f}{row.impulse:8.3f}{row.beyond:8.2f}{row.standing:8.3f}"
                f"{row.stops:6d}  {words}",
                flush=True,
            )
    return 0


def worst(rows: list[Outcome]) -> Outcome:
    """The largest of each."""
    return Outcome(*(max(column) for column in zip(*rows, strict=True)))


if __name__ == "__main__":
    sys.exit(main())
