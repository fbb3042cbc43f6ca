# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.identified``: dcarc designed from what ``identify`` measures on each wide-box valve.

Each valve is tested in simulation without feedback, by a stepped sine and a slow triangle, with its friction,
noise and dead time. Model, dead time, noise, friction and presliding come from that alone; the gains besides
are one set for all valves. Beside it the laws of ``--against``, tuned for the box.
"""

import argparse
import contextlib
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import tqdm

from research import comparison
from research.comparison import NOISE_SEED, PERIOD, U_MAX, Setup
from valve_control import outputs
from valve_control.control.commands import scenarios
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.simulation import batch
from valve_control.design.identification import (
    bode_fit,
    characteristic,
    experiment,
    first_gains,
    friction,
    lvdt,
    theta,
)
from valve_control.design.identification.experiment import Experiment
from valve_control.design.identification.response import Segment
from valve_control.parameter import ParameterError, Values, defaults, updated

NOISE = 300_000  # seed of the tests
AMPLITUDE = 6.0  # V  of the stepped sine: above all friction of the box
ROUNDS = 2
ALONE, TUNED = "the file of identify alone", "with tuned gains"
CHUNK = 8  # valves whose tests are kept at a time
IDENTIFIED = (
    *("model", "numerator", "denominator", "delay", "lvdt_noise", "lvdt_resolution"),
    *("theta_initial", "theta_max", "theta_spread", "presliding"),
)
GIVEN = tuple(f"dcarc.{name}" for name in IDENTIFIED)


def tested(plants: list[Any], given: dict[str, object], first: int) -> list[Experiment]:
    """The same test of each of ``plants``."""
    values = experiment.test_values(given, PERIOD)
    motion = build.commands(values)
    segments: tuple[Segment, ...] = ()
    if values["scenario"] == "stepped_sine":
        shape = build.shape(values)
        segments = tuple(
            Segment(
                math.ceil((shape.start + step.start) / PERIOD - 1e-9),
                min(len(motion), math.floor((shape.start + step.end) / PERIOD + 1e-9)),
                step.frequency,
            )
            for step in scenarios.steps_of(shape)
        )
    open_loop = updated(
        CONTROLLER,
        defaults(CONTROLLER),
        {"controller": "open_loop", "open_loop.static_gain": 1.0, "command_limit": 100.0},
    )
    traces = np.empty((len(plants), len(motion), 3))
    seeds = NOISE + first + np.arange(len(plants))
    params = LAWS["open_loop"].build(open_loop)
    batch.simulate(batch.Batch("open_loop", params, batch.records(plants), seeds, motion), 1, traces)
    return [Experiment("", PERIOD, motion, trace[:, 1].copy(), segments, U_MAX, ()) for trace in traces]


def identified(sine: Experiment, triangle: Experiment) -> tuple[Values, friction.Friction, float]:
    """Parameters of dcarc as ``identify --friction`` writes them, friction and dead time [s].

    Raises ParameterError.
    """
    measured = experiment.estimate(sine, 0.4, None)
    model, delay = bode_fit.fit(measured, 2).model, 0.0
    for _ in range(ROUNDS):
        found, _ = characteristic.friction_and_curve(triangle, friction.lag_of(model, delay))
        measured = experiment.estimate(friction.without(sine, found), 0.4, None)
        second = best = bode_fit.fit(measured, 2)
        with contextlib.suppress(ParameterError):
            best = bode_fit.choose(measured, order=4)
        model, delay = best.model, best.delay
    suggested = theta.suggest(measured, second, best, U_MAX)
    known = first_gains.KnownValve(model, delay, suggested, lvdt.observe(sine.position), PERIOD, U_MAX, found)
    return first_gains.dcarc_values(known), found, delay


def _joined(parts: list[comparison.Errors]) -> comparison.Errors:
    """Errors of several groups of valves as of one."""
    return comparison.Errors(*(np.concatenate(column, axis=1) for column in zip(*parts, strict=True)))


def _tuned(path: Path) -> Setup:
    """Gains of another law that are tuned for the box."""
    (found,) = (s for s in comparison.setups(path.parent, "wide", 0.25) if path.stem.endswith(s.name))
    return found


def main() -> int:
    """Identify, measure, write."""
    options = argparse.ArgumentParser(prog="benchmarks.identified", description=__doc__)
    options.add_argument("--valves", type=int, default=200, help="measured on (200)")
    options.add_argument("--seed", type=int, default=999, help="of the valves (999)")
    options.add_argument(
        "--gains",
        default="config/tuned/identified_0.25_dcarc.yaml",
        help="dcarc's gains beside what is identified",
    )
    options.add_argument(
        "--against", nargs="*", default=[], metavar="FILE", help="gains of other laws, tuned for the wide box"
    )
    options.add_argument(
        "--json", default="out/identified.json", metavar="FILE", help="(out/identified.json)"
    )
    arguments = options.parse_args()
    Path(arguments.json).parent.mkdir(parents=True, exist_ok=True)
    plants = comparison.valves(arguments.valves, arguments.seed, True)
    gains = files.load(arguments.gains)["controller"]
    others = {path: _tuned(Path(path)) for path in arguments.against}
    found: dict[str, list[comparison.Errors]] = {}
    told: list[dict[str, Any]] = []
    for first in tqdm.tqdm(range(0, len(plants), CHUNK), desc="identify", unit=f"x{CHUNK} valves"):
        some = plants[first : first + CHUNK]
        sines = tested(some, {"amplitude": AMPLITUDE}, first)
        triangles = tested(some, friction.TEST, first)
        kept: list[Any] = []
        setups: dict[str, list[Setup]] = {ALONE: [], TUNED: []}
        for plant, sine, triangle in zip(some, sines, triangles, strict=True):
            try:
                values, rubbing, delay = identified(sine, triangle)
                whole: Values = {"controller": "dcarc", **values}
                LAWS["dcarc"].build(updated(CONTROLLER, defaults(CONTROLLER), whole))
            except ParameterError as error:
                told.append({"refused": str(error)})
                continue
            kept.append(plant)
            setups[ALONE].append(Setup(ALONE, whole, 0.0))
            taken = {name: value for name, value in values.items() if name in GIVEN}
            setups[TUNED].append(Setup(TUNED, {**gains, **taken}, 0.0))
            told.append(
                {
                    "coulomb": [plant.disturbance.coulomb, rubbing.coulomb],
                    "presliding": [plant.disturbance.presliding, rubbing.presliding],
                    "delay_s": [plant.lvdt.delay * PERIOD, delay],
                }
            )
        if not kept:
            continue
        rows = batch.records(kept)
        given: dict[str, Setup | list[Setup]] = {**setups, **others}
        for name, setup in given.items():
            errors = comparison.measured(setup, rows, NOISE_SEED + first)
            found.setdefault(name, []).append(errors)
        result = {
            "valves": first + len(some),
            "seed": arguments.seed,
            "unit": "mV",
            "gains": arguments.gains,
            "refused": sum("refused" in row for row in told),
            **{name: comparison.summary(_joined(parts)) for name, parts in found.items()},
            "identified": told,
        }
        outputs.write(arguments.json, outputs.as_json(result))
    print(f"wrote {arguments.json}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
