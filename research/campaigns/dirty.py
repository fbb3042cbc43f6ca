# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Faults with noise and hum, offline: the supervisor sample by sample around a simulated valve, in C.

python -m research.campaigns.dirty            each fault and each motion with six laws, about a minute
python -m research.campaigns.dirty --full     all laws, noises, converters, frictions and motions

Each fault of LVDT, valve and supply comes at rest, in motion and from the start, with noise of 0, 1 and 10
counts of the converter or with a hum. A row has the worst case of a law: time until 0 V, volt-seconds until
then, how far the true spool went beyond the command, and for how long more than ``lvdt.disturbance``, beside
the voltage that the command itself asks for, stood without a break. Then sound valves rest, step and follow
sines, with friction of 0.5 to 4 times: none may be stopped. All runs are those of the exported C. One run of
each fault and law is repeated by the supervisor in Python: the voltages must have the same bits, and its
reports tell of the faults that are not stopped.
"""

import argparse
import ctypes
import itertools
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build, files, ros_file
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision import answer
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.export import compiler, sources, unit
from valve_control.parameter import Values, defaults, number, updated

PERIOD = 0.001  # s
BEGIN = 0.7  # s  of the fault, unless it is there from the start
OBSERVED = 3.0  # s  from then on
MAINS = 50.0  # Hz
HUM = 0.02  # V
BITS = {10: 20.0 / 2**10, 12: 20.0 / 2**12, 16: 20.0 / 2**16, 0: 0.0}  # V  steps of converters over ±10 V
NOISES = ("0", "1", "10", "hum")  # counts, or hum
WHEN = ("start", "rest", "motion")
FRICTIONS = (0.5, 1.0, 2.0, 4.0)  # times that of the valve
SINES = (0.05, 0.2, 1.0, 3.0, 10.0)  # Hz
MOTIONS = ("rest", "steps", *(f"{frequency:g} Hz" for frequency in SINES))
SOUND = 20.0  # s
TUNED = tuple(
    f"{valve_name}_{law}"
    for valve_name in ("d3fxe", "d3fxe_experiment")
    for law in ("arc", "oarc", "dcarc", "pid")
)
FEW = ("arc", "oarc", "dcarc", "pid", "d3fxe_experiment_dcarc", "compensator")
Array = npt.NDArray[np.float64]


class Fault(NamedTuple):
    """The reading instead of the true one, where the spool cannot move, and the voltage that reaches it."""

    scale: float = 1.0  # of the true reading
    offset: float = 0.0  # V
    stays: bool = False  # the last sound reading counts instead of ``offset``
    late: int = 0  # samples
    held: bool = False  # the spool
    powered: bool = True


FAULTS = {
    "dead at -10 V": Fault(scale=0.0, offset=-10.0),
    "dead at -9 V": Fault(scale=0.0, offset=-9.0),
    "dead at 0 V": Fault(scale=0.0),
    "dead where it is": Fault(scale=0.0, stays=True),
    "stuck": Fault(held=True),
    "supply off": Fault(powered=False),
    "flipped": Fault(scale=-1.0),
    "half": Fault(scale=0.5),
    "flat": Fault(scale=0.05),
    "offset of 3 V": Fault(offset=3.0),
    "late by 10 ms": Fault(late=10),
}


class Case(NamedTuple):
    """One run; ``motion`` beside a fault is one of WHEN, without one it is one of MOTIONS."""

    law: str  # or a file of config/tuned
    fault: str = ""
    noise: str = "0"
    motion: str = "rest"
    bits: int = 12
    friction: float = 1.0  # times that of the valve
    level: float = 1.0  # V  of the command at rest


class Signals(NamedTuple):
    """Signals of a case that come from outside, sample by sample."""

    command: Array  # V
    noise: Array  # standard normal, of the LVDT
    beside: Array  # V  that is added to the reading
    begin: int  # first sample of the fault


class Run(NamedTuple):
    """One run, sample by sample."""

    position: Array  # V  true
    voltage: Array  # V
    off: npt.NDArray[np.int8]


class Outcome(NamedTuple):
    """Of one fault."""

    reaction: float  # s  until 0 V, inf: never
    impulse: float  # V·s  until then, beyond the voltage that holds the command
    beyond: float  # V  of the true spool beyond neutral and command
    standing: float  # s  longest stretch above lvdt.disturbance, beside the voltage that the command asks for


@cache
def setting(name: str) -> tuple[Values, Values]:
    """Values of controller and valve of a law, or of a file of config/tuned."""
    folder = ros_file.config_folder()
    plant = "d3fxe_experiment" if name.startswith("d3fxe_experiment") else "d3fxe"
    own = files.load(str(folder / f"{plant}.yaml"))
    gains: Values = {"controller": name}
    if name in TUNED:
        gains = dict(files.load(str(folder / "tuned" / f"{name}.yaml"))["controller"])
    return (
        updated(CONTROLLER, defaults(CONTROLLER), {**own.get("controller", {}), **gains}),
        updated(VALVE, defaults(VALVE), own["valve_simulator"]),
    )


def friction(case: Case) -> float:
    """Coulomb friction [V]."""
    return case.friction * number(setting(case.law)[1], "friction.coulomb")


def signals(case: Case) -> Signals:
    """Signals of ``case``."""
    begin = round(BEGIN / PERIOD) if case.fault and case.motion != "start" else 0
    samples = begin + round(OBSERVED / PERIOD) if case.fault else round(SOUND / PERIOD)
    times = PERIOD * np.arange(samples)
    random = np.random.default_rng(1)
    command = np.full(samples, case.level)
    if case.motion == "motion":
        command = 2.0 * np.sin(2.0 * math.pi * 1.5 * times)
    elif case.motion == "steps":
        command = np.array([1.0, 3.0, -2.0, 0.0])[(times // 0.5).astype(int) % 4]
    elif case.motion.endswith("Hz"):
        frequency = float(case.motion.removesuffix(" Hz"))
        command = (0.6 if frequency > 5.0 else 2.0) * np.sin(2.0 * math.pi * frequency * times)
    counts = 0 if case.noise == "hum" else int(case.noise)
    beside: Array = BITS[case.bits] * random.integers(-counts, counts + 1, samples).astype(np.float64)
    if case.noise == "hum":
        beside = HUM * np.sin(2.0 * math.pi * MAINS * times)
    if case.fault:
        beside[:begin] = 0.0
    return Signals(command, random.standard_normal(samples), beside, begin)


def samples(case: Case, given: Signals) -> Iterator[tuple[float, float, Supervisor]]:
    """True position and voltage [V] of each sample, and the supervisor: the run in Python."""
    values, plant = setting(case.law)
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    p = build.valve_params({**plant, "friction.coulomb": friction(case)})
    s, last, grain = valve.initial(p), 0.0, BITS[case.bits]
    fault, past = FAULTS.get(case.fault, Fault()), []
    commands, noise, beside = (array.tolist() for array in given[:3])
    for k in range(len(commands)):
        reading = valve.read(p, s, noise[k])
        past.append(reading)
        if k < given.begin:
            last = reading
        elif fault.late:
            reading = past[k - fault.late] if k >= fault.late else 0.0
        else:
            reading = fault.scale * reading + (last if fault.stays else fault.offset)
        reading += beside[k]
        if grain > 0.0:
            reading = grain * math.floor(reading / grain + 0.5)
        supervisor.command(commands[k])
        voltage = supervisor.sample(reading, k + 1)
        yield s.x.x0, voltage, supervisor
        if not (k >= given.begin and fault.held):
            s = valve.step(p, s, voltage if fault.powered or k < given.begin else 0.0)


class CFault(ctypes.Structure):
    """``fault_t`` of dirty.c."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("begin", "late", "stays", "held", "unpowered")),
        *((name, ctypes.c_double) for name in ("scale", "offset", "grain", "coulomb")),
    )


@cache
def library(law: str) -> Any:
    """The function ``run`` of dirty.c with the exported C of ``law`` and its valve."""
    values, plant = setting(law)
    with tempfile.TemporaryDirectory(prefix="valve_control-dirty-") as name:
        place = Path(name)
        supervised = unit.supervised(values)
        for stem, made in (("law", sources.make(supervised)), ("valve", sources.make(unit.plant(plant)))):
            header = supervised.name if stem == "law" else stem
            (place / f"{stem}.h").write_text(made.header, encoding="utf-8")
            source = made.source.replace(f'"{header}.h"', f'"{stem}.h"')
            (place / f"{stem}.c").write_text(source, encoding="utf-8")
        inputs = [Path(__file__).with_suffix(".c"), place / "law.c", place / "valve.c"]
        options = [f"-I{place}", f"-DNAME={supervised.name}", "-fPIC", "-shared"]
        compiler.build(inputs, place / "run.so", options)
        return ctypes.CDLL(str(place / "run.so")).run


def run(case: Case, given: Signals) -> Run:
    """The run in C."""
    fault, count = FAULTS.get(case.fault, Fault()), len(given.command)
    made = Run(np.empty(count), np.empty(count), np.empty(count, np.int8))
    begin = given.begin if case.fault else count
    flags = (begin, fault.late, fault.stays, fault.held, not fault.powered)
    of_fault = CFault(*map(int, flags), fault.scale, fault.offset, BITS[case.bits], friction(case))
    arrays = [np.ascontiguousarray(array).ctypes.data_as(ctypes.c_void_p) for array in (*given[:3], *made)]
    library(case.law)(ctypes.byref(of_fault), ctypes.c_int64(count), *arrays)
    return made


def outcome(case: Case, given: Signals, made: Run) -> Outcome:
    """What became of a run with a fault."""
    command, (position, voltage, off) = given.command[given.begin :], (a[given.begin :] for a in made)
    low = np.minimum(np.minimum.accumulate(command), 0.0)
    high = np.maximum(np.maximum.accumulate(command), 0.0)
    beyond = float(np.max(np.maximum(low - position, position - high), initial=0.0))
    reaction = int(np.argmax(off)) if np.any(off) else len(off)
    excess = np.maximum(0.0, np.abs(voltage) - 1.1 * np.abs(command))[:reaction]
    pull = np.abs(voltage) - answer.SPREAD * np.abs(command)
    above = pull > number(setting(case.law)[0], "lvdt.disturbance")
    stretches = np.diff(np.flatnonzero(np.concatenate(([True], ~above, [True])))) - 1
    return Outcome(
        reaction * PERIOD if reaction < len(off) else math.inf,
        PERIOD * float(np.sum(excess)),
        beyond,
        PERIOD * float(np.max(stretches)),
    )


def repeated(case: Case) -> tuple[bool, str]:
    """Whether Python has the same voltages to the last bit, and the conditions that it reports."""
    given = signals(case)
    made, voltages = run(case, given), []
    reports: dict[str, float] = {}
    for k, (_, voltage, supervisor) in enumerate(samples(case, given)):
        voltages.append(voltage)
        if k >= given.begin:
            for name in supervisor.conditions:
                reports.setdefault(name, (k - given.begin) * PERIOD)
    words = ", ".join(f"{name} {time:.2f} s" for name, time in reports.items())
    return np.array(voltages).tobytes() == made.voltage.tobytes(), words


def faulty(law: str, fault: str, full: bool) -> Iterator[Case]:
    """Cases of ``fault`` under ``law``: all, or each noise and time with one of two converters."""
    for i, (noise, when) in enumerate(itertools.product(NOISES, WHEN)):
        for bits in (12, 16) if full else ((12, 16)[i % 2],):
            yield Case(law, fault, noise, when, bits)


def sound(law: str, full: bool) -> Iterator[Case]:
    """Cases of sound valves: all, or each motion with each friction, and each converter in turn."""
    for i, (motion, times) in enumerate(itertools.product(MOTIONS, FRICTIONS)):
        for bits in BITS if full else (list(BITS)[(i + i // 4) % 4],):
            yield Case(law, "", "0", motion, bits, times)


def worst(rows: Sequence[Outcome]) -> Outcome:
    """The largest of each."""
    return Outcome(*(max(column) for column in zip(*rows, strict=True)))


def main(words: Sequence[str] | None = None) -> int:
    """Print the tables; 1 if a sound valve was stopped, or C and Python differ."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--full", action="store_true", help="all cases")
    parser.add_argument("--law", action="append", choices=(*LAWS, *TUNED), help="instead of several")
    parser.add_argument("--fault", action="append", choices=FAULTS, help="instead of all")
    parser.add_argument("--all", action="store_true", help="one row for each run")
    chosen = parser.parse_args(words)
    laws = chosen.law or ((*LAWS, *TUNED) if chosen.full else FEW)
    status = 0
    print(f"{'fault':18}{'law':24}{'reaction':>9}{'V·s':>8}{'beyond':>8}{'> D for':>8}")
    for fault, law in itertools.product(chosen.fault or FAULTS, laws):
        cases = list(faulty(law, fault, chosen.full))
        rows = [outcome(case, given, run(case, given)) for case in cases for given in [signals(case)]]
        missed = max(range(len(rows)), key=lambda i: (rows[i].reaction, rows[i].beyond))
        same, reports = repeated(cases[missed])
        shown = list(zip(cases, rows, strict=True)) if chosen.all else [(cases[missed], worst(rows))]
        for case, row in shown:
            figures = f"{row.reaction:9.3f}{row.impulse:8.3f}{row.beyond:8.2f}{row.standing:8.3f}"
            print(
                f"{fault:18}{law:24}{figures}  {case.motion} {case.noise} {case.bits}: {reports}", flush=True
            )
        if not same:
            status = 1
            print(f"DIFFERENT BITS in C and Python: {cases[missed]}")
    runs = 0
    for case in [] if chosen.fault else itertools.chain(*(sound(law, chosen.full) for law in laws)):
        given = signals(case)
        runs += 1
        if np.any(run(case, given).off):
            status = 1
            print(f"STOPPED: {case}: {repeated(case)[1]}", flush=True)
    print(f"{runs} runs of sound valves of {SOUND:g} s")
    return status


if __name__ == "__main__":
    sys.exit(main())
