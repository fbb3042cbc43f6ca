# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Batches of valves against python-control and a loop in the exported C; two cores against one."""

import ctypes
import platform
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.control.laws.registry import LAWS as REGISTERED
from valve_control.control.laws.signals import Start
from valve_control.control.linear.linear_loop import flatten, unflatten
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES
from valve_control.control.plant import sensor, valve
from valve_control.control.simulation import batch, offline
from valve_control.export import sources, unit
from valve_control.parameter import Values, defaults, updated

Array = npt.NDArray[np.float64]
LAWS = ("arc", "oarc")
VALVE = {
    "friction.coulomb": 1.16,
    "friction.static_ratio": 1.25,
    "friction.stribeck_velocity": 0.017,
    "friction.presliding": 0.0033,
    "flow_force": 0.116,
    "gain_scale": 1.213,
    "lvdt.noise": 0.0056,
    "lvdt.resolution": 0.0037,
}  # near the calibrated one
WANTED = {  # low or high bounds
    "step_ns_arc": ("at most", 50.0),
    "step_ns_oarc": ("at most", 50.0),
    "two_cores_ratio": ("at least", 1.8),
    "vs_python_control": ("at least", 1000.0),
    "vs_c": ("at most", 1.5),
}
SOURCE = Path(__file__).with_name("loop.c")
Measure = Callable[[], float]  # seconds


class BenchmarkError(RuntimeError):
    """What a benchmark needs is missing, or it does not compute the same."""


def settings(controller: str) -> tuple[Values, Values]:
    """Controller's and valve's values."""
    changes = {"controller": controller}
    return (
        updated(NODES["controller"], defaults(NODES["controller"]), changes),
        updated(NODES["valve_simulator"], defaults(NODES["valve_simulator"]), VALVE),
    )


def many(controller: str, valves: int, seconds: float) -> batch.Batch:
    """Valves that differ in gain, friction and seed, on the paper's strokes."""
    controller_values, valve_values = settings(controller)
    rows = batch.records([build.valve_params(valve_values)] * valves)
    random = np.random.default_rng(1)
    rows["gain_scale"] *= random.uniform(0.8, 1.2, valves)
    rows["disturbance"]["coulomb"] *= random.uniform(0.5, 1.5, valves)
    source = updated(NODES["command_source"], defaults(NODES["command_source"]), {"duration": seconds})
    laws = batch.records([build.law_params(controller_values)] * valves)
    return batch.Batch(controller, laws, rows, np.arange(1, valves + 1), build.commands(source))


def in_turns(measures: Sequence[Measure], rounds: int) -> list[list[float]]:
    """Times [s] of each, measured in turns so that a busy machine is busy for all."""
    times: list[list[float]] = [[] for _ in measures]
    for _ in range(rounds):
        for measure, found in zip(measures, times, strict=True):
            found.append(measure())
    return times


def timed(work: Callable[..., Any], *arguments: Any) -> Measure:
    """Measure of ``work``."""

    def measure() -> float:
        began = time.perf_counter()
        work(*arguments)
        return time.perf_counter() - began

    return measure


def twice(work: Callable[..., Any], *arguments: Any) -> None:
    """``work`` in two threads at once: what the machine's second core is worth just now."""
    threads = [threading.Thread(target=work, args=arguments) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def c_library(folder: Path, controller: str, options: Sequence[str]) -> ctypes.CDLL:
    """The exported C of law and valve in benchmarks/loop.c, with numpy's own C library for the noise.

    Raises BenchmarkError.
    """
    compiler = shutil.which("gcc")
    if compiler is None:
        raise BenchmarkError("vs_c needs gcc, which is not installed (Debian, Ubuntu: apt install gcc)")
    controller_values, valve_values = settings(controller)
    place = Path(tempfile.mkdtemp(dir=folder))
    for exported in (unit.law(controller_values), unit.plant(valve_values)):
        made = sources.make(exported)
        (place / f"{exported.name}.h").write_text(made.header, encoding="utf-8")
        (place / f"{exported.name}.c").write_text(made.source, encoding="utf-8")
    library = place / "loop.so"
    noise = Path(np.random.__file__).parent / "lib" / "libnpyrandom.a"
    names = [f"-DLAW={controller}", f'-DLAW_SOURCE="{controller}.c"', f"-I{place}"]
    command = [
        compiler,
        *options,
        *names,
        "-fPIC",
        "-shared",
        str(SOURCE),
        str(noise),
        "-lm",
        "-o",
        str(library),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BenchmarkError(f"gcc cannot compile {SOURCE.name}: {done.stderr.strip().splitlines()[-1]}")
    return ctypes.CDLL(str(library))


def run_in_c(library: ctypes.CDLL, chosen: batch.Batch) -> Array:
    """Indices (N×5) of the batch from the C loop. Raises BenchmarkError if its structs have other fields."""
    for name, rows in (("law", chosen.law_params), ("valve", chosen.valve_params)):
        assert isinstance(rows, np.ndarray)
        if getattr(library, f"bytes_{name}")() != rows.dtype.itemsize:
            raise BenchmarkError(f"the exported struct has other fields than the parameters of the {name}")
    count, n = len(chosen.seeds), chosen.commands.shape[-1]
    indices, noise = np.zeros((count, 5)), np.zeros(n)
    generators = [np.random.PCG64(int(seed)) for seed in chosen.seeds]
    addresses = (ctypes.c_void_p * count)(*(g.ctypes.bit_generator for g in generators))
    assert isinstance(chosen.valve_params, np.ndarray)
    period = float(chosen.valve_params["period"][0])
    double_p = ctypes.POINTER(ctypes.c_double)

    def data(array: Any) -> Any:
        return array.ctypes.data_as(double_p)

    library.run(
        data(chosen.law_params),
        data(chosen.valve_params),
        addresses,
        ctypes.c_ssize_t(count),
        data(chosen.commands),
        data(noise),
        ctypes.c_ssize_t(n),
        ctypes.c_ssize_t(n - min(n, round(2.0 / period) + 1)),
        data(indices),
    )
    return indices


def run_in_python_control(controller: str, commands: Array, noise: Array) -> Array:
    """Measurements [V] of the same closed loop: two blocks, connected and run by python-control.

    Raises BenchmarkError without python-control.
    """
    try:
        import control
    except ModuleNotFoundError as error:
        raise BenchmarkError("vs_python_control needs python-control (pip install control)") from error

    controller_values, valve_values = settings(controller)
    law = REGISTERED[controller].module
    p, plant = build.law_params(controller_values), build.valve_params(valve_values)
    first = sensor.reading(plant.lvdt, 0.0, noise[0])
    start = law.initial(p, Start(first, 0.0, first, 0.0, 0.0))
    still = batch.SpoolState(valve.Row(0.0, 0.0, 0.0, 0.0), 0.0, 0.0)
    none = np.zeros(1)

    def law_next(t: float, x: Array, u: Array, _: Any) -> list[float]:
        return flatten(law.step(p, unflatten(start, x.tolist()), float(u[0]), float(u[1]), 0.0)[1])

    def law_output(t: float, x: Array, u: Array, _: Any) -> float:
        voltage: float = law.step(p, unflatten(start, x.tolist()), float(u[0]), float(u[1]), 0.0)[0]
        return voltage

    def valve_next(t: float, x: Array, u: Array, _: Any) -> list[float]:
        s = unflatten(still, x.tolist())
        after = valve.step(plant, valve.State(s.x, s.bristle, s.time, none, 0), float(u[0]))
        return [*after.x, after.bristle, after.time]

    def valve_output(t: float, x: Array, u: Array, _: Any) -> float:
        return sensor.reading(plant.lvdt, float(x[0]), float(u[1]))

    period = plant.period
    names = [f"s{i}" for i in range(len(flatten(start)))]
    block = control.nlsys(
        law_next, law_output, inputs=["command", "reading"], outputs=["voltage"], states=names, dt=period,
        name="law",
    )  # fmt: skip
    spool = control.nlsys(
        valve_next, valve_output, inputs=["voltage", "noise"], outputs=["reading"], states=6, dt=period,
        name="valve",
    )  # fmt: skip
    loop = control.interconnect([block, spool], inputs=["command", "noise"], outputs=["reading"])
    response = control.input_output_response(
        loop,
        np.arange(len(commands)) * period,
        np.stack([commands, noise[: len(commands)]]),
        flatten(start) + [0.0] * 6,
    )
    readings: Array = np.ravel(response.outputs)
    return readings


def same(name: str, found: Array, expected: Array) -> None:
    """Raise BenchmarkError unless both agree."""
    if not np.allclose(found, expected, rtol=1e-9, atol=1e-9):
        raise BenchmarkError(
            f"{name} computes something else: off by {np.max(np.abs(found - expected)):.3g} V"
        )


def against_python_control(controller: str, seconds: float, step: float) -> dict[str, Any]:
    """Ratio of times a step, after the same readings; ``step`` [s]: of the batch."""
    controller_values, valve_values = settings(controller)
    commands = many(controller, 1, seconds).commands
    noise = np.random.default_rng(1).standard_normal(len(commands))
    began = time.perf_counter()
    readings = run_in_python_control(controller, commands, noise)
    took = (time.perf_counter() - began) / len(commands)
    same("python-control", readings, offline.simulate(controller_values, valve_values, commands).measurement)
    return {"step_us": 1e6 * took, "ratio": took / step}


def machine() -> dict[str, Any]:
    """What this ran on."""
    model = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if "model name" in line
        ]
        model = f"{len(names)} x {names[0]}" if names else model
    return {
        "processor": model,
        "system": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


def run(folder: Path, valves: int = 256, seconds: float = 6.0, rounds: int = 9) -> dict[str, Any]:
    """Measure; a table, and the figures for JSON. Raises BenchmarkError."""
    results: dict[str, Any] = {"valves": valves, "seconds": seconds}
    compilers = {"vs_c": ["-O3"], "vs_c_native": ["-O3", "-march=native", "-ffp-contract=off"]}
    print(
        f"{'':6}{'step [ns]':>10}{'C -O3':>8}{'C native':>10}{'2 cores':>9}{'(C)':>6}{'python-control':>16}"
    )
    for controller in LAWS:
        chosen = many(controller, valves, seconds)
        steps = valves * chosen.commands.shape[-1]
        libraries = {name: c_library(folder, controller, options) for name, options in compilers.items()}
        indices = np.stack(batch.simulate(chosen)[:5], axis=1)  # compiles
        for name, library in libraries.items():
            same(f"loop.c ({name})", run_in_c(library, chosen), indices)
        double = chosen._replace(
            law_params=np.tile(chosen.law_params, 2),
            valve_params=np.tile(chosen.valve_params, 2),
            seeds=np.arange(1, 2 * valves + 1),
        )
        one, two, both, *in_c = in_turns(
            [
                timed(batch.simulate, chosen, 1),
                timed(batch.simulate, double, 2),
                timed(twice, run_in_c, libraries["vs_c"], chosen),
                *(timed(run_in_c, library, chosen) for library in libraries.values()),
            ],
            rounds,
        )
        best = min(one)
        against = against_python_control(controller, min(seconds, 1.0), best / steps)
        entry = {
            "step_ns": 1e9 * best / steps,
            "step_ns_each": [1e9 * t / steps for t in one],
            "two_cores_ratio": 2.0 * best / min(two),
            "two_cores_ratio_of_c": 2.0 * min(in_c[0]) / min(both),
            **{name: best / min(times) for name, times in zip(libraries, in_c, strict=True)},
            "c_step_ns": 1e9 * min(in_c[0]) / steps,
            "c_native_step_ns": 1e9 * min(in_c[1]) / steps,
            "python_control_step_us": against["step_us"],
            "vs_python_control": against["ratio"],
        }
        results[controller] = entry
        print(
            f"{controller:6}{entry['step_ns']:10.1f}{entry['c_step_ns']:8.1f}{entry['c_native_step_ns']:10.1f}"
            f"{entry['two_cores_ratio']:9.2f}{entry['two_cores_ratio_of_c']:6.2f}{entry['vs_python_control']:16.0f}"
        )
    results["figures"] = {
        **{f"step_ns_{name}": results[name]["step_ns"] for name in LAWS},
        "two_cores_ratio": min(results[name]["two_cores_ratio"] for name in LAWS),
        "two_cores_ratio_of_c": min(results[name]["two_cores_ratio_of_c"] for name in LAWS),
        "vs_python_control": min(results[name]["vs_python_control"] for name in LAWS),
        "vs_c": max(results[name]["vs_c"] for name in LAWS),
        "vs_c_native": max(results[name]["vs_c_native"] for name in LAWS),
    }
    return results
