# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Axes: a step of the axis alone, a sample of the whole cascade, and batches of axes on two cores.

The first two are times of the processor, which another program on it hardly changes; the batch on two cores
is timed by the clock.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.batch import Measure, in_turns, timed
from valve_control.axis import axis, cascade
from valve_control.axis import run as runs
from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.axis.upper import LEVELS
from valve_control.control.compiling import compile_function
from valve_control.control.parameters import files, ros_file
from valve_control.parameter import Values, updated

Array = npt.NDArray[np.float64]
SIGNALS = len(cascade.SIGNALS)
AXES, STEPS = 48, 100_000  # of the batch; of the axis alone
MANY, SECONDS = 10_000, 6.0  # how many axes of how long are to be done within two minutes
WANTED = {
    "axis_step_us": ("at most", 1.0),
    "axes_minutes": ("at most", 2.0),
}  # low or high bounds


def worked(work: Callable[..., Any], *arguments: Any) -> Measure:
    """Measure of ``work`` in seconds of the processor."""

    def measure() -> float:
        began = time.process_time()
        work(*arguments)
        return time.process_time() - began

    return measure


def drive(p: axis.Params, s: axis.State, spool: Array) -> axis.State:
    """State after a step for each entry of ``spool`` [V] but the first."""
    for k in range(1, len(spool)):
        s = axis.step(p, s, spool[k - 1], 0.0, spool[k], 0.0)
    return s


def batch(setups: Sequence[runs.Setup], threads: int) -> list[runs.Indices]:
    """Indices of many axes, on so many ``threads``."""
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda s: runs.indices_of(s, np.empty((len(s.goals), SIGNALS))), setups))


def settings(level: str) -> dict[str, Values]:
    """Values by node of the bench under an upper level, over 6 s."""
    path = str(ros_file.config_folder() / "axis" / "bench.yaml")
    own = {"axis_controller": {"upper_level": level, "duration": SECONDS}}
    own["controller"] = {"controller": "oarc"}
    given = files.given([path], own, [], None, AXIS_NODES)
    begun = runs.default_settings()
    return {node: updated(table, begun[node], given[node]) for node, table in AXIS_NODES.items()}


def run(rounds: int = 5) -> dict[str, Any]:
    """Measure; a table, and the figures for JSON."""
    setups = {level: runs.setup(settings(level)) for level in LEVELS}
    one = next(iter(setups.values()))
    spool = 5.0 * np.sin(2.0 * np.pi * 2.0 * np.arange(STEPS) * one.machine.axis.period)
    driven = compile_function(drive)
    driven(one.machine.axis, one.begin.axis, spool[:2])  # compiles
    batches = {level: [s._replace(seed=k) for k in range(AXES)] for level, s in setups.items()}
    for setup in setups.values():
        batch([setup._replace(goals=setup.goals[:1])], 1)  # compiles
    alone, *found = in_turns(
        [
            worked(driven, one.machine.axis, one.begin.axis, spool),
            *(
                kind(batch, b, threads)
                for b in batches.values()
                for kind, threads in ((worked, 1), (timed, 2))
            ),
        ],
        rounds,
    )
    samples = AXES * len(one.goals)
    results: dict[str, Any] = {"axes": AXES, "step_us": 1e6 * min(alone) / STEPS, "levels": {}}
    print(
        f"a step of the axis alone, {one.machine.axis.steps} integration steps: {results['step_us']:.2f} µs"
    )
    print(f"{'':10}{'sample of one core [µs]':>25}{'of two':>8}{f'{MANY} axes of {SECONDS:g} s [min]':>30}")
    for level, single, double in zip(batches, found[::2], found[1::2], strict=True):
        entry = {
            "sample_us": 1e6 * min(single) / samples,
            "two_cores_sample_us": 1e6 * min(double) / samples,
            "minutes": min(double) / AXES * MANY / 60.0,
        }
        results["levels"][level] = entry
        print(
            f"{level:10}{entry['sample_us']:25.2f}{entry['two_cores_sample_us']:8.2f}{entry['minutes']:30.2f}"
        )
    results["figures"] = {
        "axis_step_us": results["step_us"],
        "axes_minutes": max(entry["minutes"] for entry in results["levels"].values()),
    }
    return results
