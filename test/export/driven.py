# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the steps of a law on many parameter sets: in Python, plain or compiled, and in the exported C."""

import shutil
import struct
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from valve_control.control.compiling import compile_function
from valve_control.control.laws.signals import Start
from valve_control.control.linear.linear_loop import flatten
from valve_control.control.parameters.table import CONTROLLER
from valve_control.export import sources, unit
from valve_control.parameter import ParameterError, defaults

DRIVE = Path(__file__).with_name("drive.c")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror")
# Compiled without optimisation in a third of the time; as users compile it, it runs without them.
SANITIZERS = ("-O0", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
BOTH = ("gcc", "clang")
COMPILERS = [name for name in BOTH if shutil.which(name)]
EACH_COMPILER = pytest.mark.parametrize(
    "compiler",
    [
        pytest.param(
            name,
            marks=pytest.mark.skipif(name not in COMPILERS, reason=f"{name} is not here: apt install {name}"),
        )
        for name in BOTH
    ],
)
START = Start(0.3, 0.5, 0.3, 1.0, 1.0)


class Case(NamedTuple):
    """Signals that go to every set: event (0 step, 1 hold, 2 takeover), command, reading, offset."""

    rows: np.ndarray
    chunk: int


def case(samples, chunk, seed=0):
    """Steps and noise over more than the stroke, gaps, takeovers in motion whose offset fades out."""
    random = np.random.default_rng(seed)
    level = np.repeat(random.uniform(-11.0, 11.0, samples // 50 + 1), 50)[:samples]
    quick = 10.0 ** random.uniform(-3.0, 0.5)
    command = np.where(random.random(samples) < 0.5, level, level + quick * random.standard_normal(samples))
    reading = np.zeros(samples)
    for k in range(1, samples):
        reading[k] = reading[k - 1] + 0.05 * (level[k - 1] - reading[k - 1])
    reading = np.round((reading + 0.006 * random.standard_normal(samples)) / 0.0037) * 0.0037
    event = np.where(random.random(samples) < 0.03, 1.0, 0.0)
    event[random.random(samples) < 0.003] = 2.0
    offset = np.zeros(samples)
    for k in range(1, samples):
        offset[k] = 2.0 if event[k] == 2.0 else 0.95 * offset[k - 1]
    offset[np.abs(offset) < 1e-3] = 0.0
    return Case(np.stack([event, command, reading, offset], axis=1), chunk)


def random_params(law, random):
    """Params of a set of values all over the ranges, within half a decade of the defaults."""
    tables = {p.name: p for p in (*law.parameters, *CONTROLLER) if p.name in shared(law)}
    while True:
        values = defaults(CONTROLLER)
        values["sample_period"] = float(random.choice([0.0005, 0.001, 0.002]))
        for name, parameter in tables.items():
            values[name] = random_value(parameter, random)
        try:
            return law.build(values)
        except ParameterError:
            continue


def shared(law):
    common = {"u_max", "reshaping.natural_frequency", "reshaping.damping", "reshaping.max_rate",
              "reshaping.max_accel", "reshaping.form"}  # fmt: skip
    return common | {p.name for p in law.parameters}


def random_value(parameter, random):
    def number(value):
        if random.random() < 0.1:
            return value
        found = value * 10.0 ** random.uniform(-0.5, 0.5) if value else random.choice([0.0, 0.002])
        return float(np.clip(found, parameter.low, parameter.high))

    if isinstance(parameter.default, bool):
        return bool(random.random() < 0.5)
    if isinstance(parameter.default, float):
        return number(parameter.default)
    if parameter.choices:
        return str(random.choice(parameter.choices))
    if isinstance(parameter.default, list) and parameter.length:
        return [number(value) for value in parameter.default]
    return parameter.default


def walk(p, s, voltage, rows, voltages):
    """Steps ``law`` over ``rows``; returns state, voltage and terms after the last."""
    terms = step(p, s, 0.0, 0.0, 0.0)[2]
    for k in range(rows.shape[0]):
        event, command, reading, offset = rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3]
        if event == 0.0:
            voltage, s, terms = step(p, s, command, reading, offset)
        elif event == 1.0:
            s = hold(p, s, command, reading, voltage)
        else:
            s = initial(p, Start(reading, voltage, reading, offset, offset))
        voltages[k] = voltage
    return s, voltage, terms


def step(p, s, command, reading, offset):
    """Placeholder for the law's."""


hold = initial = step


def in_python(law, sets, given, compiled):
    """Voltages (sets, samples), and terms with state after each chunk (sets, chunks, numbers)."""
    parts = {part: getattr(law.module, part) for part in ("step", "hold", "initial")}
    if compiled:
        run = compile_function(walk, {name: compile_function(f) for name, f in parts.items()})
    else:
        import types

        run = types.FunctionType(walk.__code__, {**walk.__globals__, **parts}, "walk")
    rows = given.rows
    voltages, ends = np.zeros((len(sets), len(rows))), []
    for i, p in enumerate(sets):
        s, voltage, found = law.module.initial(p, START), 0.0, []
        for begin in range(0, len(rows), given.chunk):
            part = rows[begin : begin + given.chunk]
            s, voltage, terms = run(p, s, voltage, part, voltages[i, begin : begin + len(part)])
            found.append(flatten(terms) + flatten(s))
        ends.append(found)
    return voltages, np.array(ends)


def build(law, folder, compiler, *options):
    """The program that runs the exported C of ``law``."""
    chosen = unit.law({**defaults(CONTROLLER), "controller": law.name})
    made = sources.make(chosen)
    (folder / f"{law.name}.h").write_text(made.header)
    (folder / f"{law.name}.c").write_text(made.source)
    program = folder / f"{law.name}_{compiler}{len(options)}"
    command = [
        compiler, *sources.FLAGS.split(), *WARNINGS, *options, f"-I{folder}", f"-DNAME={law.name}",
        f'-DHEADER="{law.name}.h"', "-o", program, DRIVE, folder / f"{law.name}.c", "-lm",
    ]  # fmt: skip
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return program


def in_c(law, program, sets, given):
    """As ``in_python``."""
    rows = given.rows
    data = struct.pack("<3Q", len(sets), len(rows), given.chunk)
    data += np.array([flatten(p) for p in sets]).tobytes() + struct.pack("<5d", *START) + rows.tobytes()
    done = subprocess.run([str(program)], input=data, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    chunks = len(rows) // given.chunk
    found = np.frombuffer(done.stdout).reshape(len(sets), chunks, -1)
    return found[:, :, : given.chunk].reshape(len(sets), -1), found[:, :, given.chunk :]


def same_bits(a, b):
    """Whether two arrays have the same bits, but for those of NaN."""
    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    return bool(np.all((a.view(np.uint64) == b.view(np.uint64)) | (np.isnan(a) & np.isnan(b))))


def finite_share(voltages):
    return float(np.mean(np.isfinite(voltages)))
