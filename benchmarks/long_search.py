# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.long_search``: the tuner against a plain CMA-ES with ten times the sets of gains.

The CMA-ES is written out here (after Hansen, The CMA Evolution Strategy: A Tutorial, 2016, with restarts and
doubled populations). Both make the same cost small: error under a limit of chatter and of saturation, with
the same margins and rest after steps, on the same valves. What each has chosen is run on valves that neither
has seen.
"""

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tqdm

from valve_control import outputs
from valve_control.control.commands import arrays
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER, NODES
from valve_control.control.simulation import robustness
from valve_control.design.tuning import box, checks, limits, search, trial, tuner
from valve_control.design.tuning.trial import GainSet
from valve_control.parameter import ParameterError, Value, defaults, updated

Array = npt.NDArray[np.float64]
Cost = Callable[[list[Array]], list[float]]
CHATTER = 0.25
QUIET = search.QUIETER * CHATTER
MORE = 1.0 / search.BACK_OFF
LIMITS = trial.USUAL
KNOWN = ("speed", "lvdt.delay", "lvdt.noise")
UNSEEN = 64  # valves
WANTED = 1.05  # error of the tuner by that of the long search
SECONDS = 60.0


def cma_es(cost: Cost, begin: Array, budget: int, seed: int) -> None:
    """Ask ``cost`` for ``budget`` points of the unit cube, beginning at ``begin``."""
    random, n, asked, population = (
        np.random.default_rng(seed),
        len(begin),
        0,
        4 + int(3 * math.log(len(begin))),
    )
    mean = begin
    while asked < budget:
        mu = population // 2
        weights = math.log(mu + 0.5) - np.log(np.arange(1, mu + 1))
        weights /= weights.sum()
        mass = 1.0 / float(np.sum(weights**2))
        c_sigma = (mass + 2.0) / (n + mass + 5.0)
        damping = 1.0 + c_sigma + 2.0 * max(0.0, math.sqrt((mass - 1.0) / (n + 1.0)) - 1.0)
        c_c = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n)
        c_1 = 2.0 / ((n + 1.3) ** 2 + mass)
        c_mu = min(1.0 - c_1, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass))
        usual = math.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))
        sigma, covariance = 0.2, np.eye(n)
        path_sigma, path_c = np.zeros(n), np.zeros(n)
        best, still, count = math.inf, 0, 0
        while asked < budget and still < 20 + 30 * n // population and sigma > 1e-5:
            values, vectors = np.linalg.eigh(covariance)
            scales = np.sqrt(np.maximum(values, 1e-20))
            steps = (vectors * scales) @ random.standard_normal((n, population))
            points = [mean + sigma * steps[:, i] for i in range(population)]
            costs = cost(points)
            asked, count = asked + population, count + 1
            order = np.argsort(costs)
            if costs[order[0]] < best - 1e-4:
                best, still = costs[order[0]], 0
            still += 1
            chosen = steps[:, order[:mu]]
            step = chosen @ weights
            mean = mean + sigma * step
            whitened = vectors @ ((vectors.T @ step) / scales)
            path_sigma = (1 - c_sigma) * path_sigma + math.sqrt(c_sigma * (2 - c_sigma) * mass) * whitened
            length = float(np.linalg.norm(path_sigma))
            moving = length / math.sqrt(1.0 - (1.0 - c_sigma) ** (2 * count)) < (1.4 + 2.0 / (n + 1)) * usual
            path_c = (1 - c_c) * path_c + moving * math.sqrt(c_c * (2 - c_c) * mass) * step
            covariance = (
                (1 - c_1 - c_mu + (not moving) * c_1 * c_c * (2 - c_c)) * covariance
                + c_1 * np.outer(path_c, path_c)
                + c_mu * (chosen * weights) @ chosen.T
            )
            sigma *= math.exp(c_sigma / damping * (length / usual - 1.0))
        population *= 2
        mean = random.random(n)


def problems(law: Law) -> tuple[trial.Problem, trial.Problem]:
    """What both searches see, and what neither does."""
    loaded = files.load("config/d3fxe.yaml")
    settings = {node: updated(table, defaults(table), loaded[node]) for node, table in NODES.items()}
    quantities = [q for q in robustness.BOX if q.name not in KNOWN]
    values, _ = box.with_dead_time(law, settings, quantities)
    values = updated(CONTROLLER, values, {"controller": law.name})
    motion = trial.TuningMotion("fast strokes", arrays.read("config/commands/fast_strokes.csv")[:4000])
    seen, other = (box.study_of(settings, quantities, count, seed) for count, seed in ((8, 1), (UNSEEN, 2)))
    problem = trial.Problem(values, [motion], box.drawn(seen), box.bounding(seen), LIMITS, False, 1)
    return problem, problem._replace(plants=box.drawn(other), box=box.bounding(other), seed=2)


def long_search(
    law: Law, problem: trial.Problem, budget: int, seed: int, told: Callable[[int], None]
) -> tuple[float, GainSet | None]:
    """Least error within the limit of the chatter, and the gains that have it."""
    free = trial.free_numbers(law, problem.values, problem.preview)
    corners = margins.prepared(problem.box)
    best: tuple[float, GainSet | None] = (math.inf, None)

    def cost(points: list[Array]) -> list[float]:
        nonlocal best
        costs = [1e3] * len(points)
        kept = []
        for i, point in enumerate(points):
            inside = np.clip(point, 0.0, 1.0)
            gains = trial.gains_at(free, problem.values, [float(v) for v in inside])
            costs[i] = float(np.sum((point - inside) ** 2))
            try:
                params = law.build(trial.values_with(problem, gains))
                missed = limits.violation(problem.limits, margins.margins(law, params, corners), MORE)
            except (ParameterError, ArithmeticError, np.linalg.LinAlgError):
                costs[i] += 1e3
                continue
            if missed > 0.0:
                costs[i] += 20.0 + missed
            else:
                kept.append((i, gains))
        outcomes = trial.run(law, problem, [gains for _, gains in kept]) if kept else []
        for (i, gains), outcome in zip(kept, outcomes, strict=True):
            error, loud = outcome.error, float(np.mean(outcome.saturated))
            beyond = max(0.0, math.log(max(outcome.chatter, 1e-9) / QUIET)) + max(0.0, loud - 0.02)
            costs[i] += math.log(error) + 6.0 * beyond if math.isfinite(error) else 100.0
            if beyond == 0.0 and error < best[0]:
                share = 1.0
                if math.isinf(checks.unborne(law, problem, [gains])[0]):
                    (share,) = checks.restless_shares(law, problem, [gains])
                if share > 0.0:
                    costs[i] = 10.0 + share
                else:
                    best = error, gains
        told(len(points))
        return costs

    cma_es(cost, np.full(len(free), 0.5), budget, seed)
    return best


def compared(law: Law, budget: int, times: int, seed: int) -> dict[str, Any]:
    """The tuner with ``budget`` sets of gains in each variant of ``law``, the other with ``times`` that."""
    problem, unseen = problems(law)
    began = time.monotonic()
    found = tuner.tuned(law, problem, unseen, CHATTER, budget, seed, lambda done: None)
    seconds = time.monotonic() - began
    chosen = found.chosen
    long: tuple[float, GainSet | None] = (math.inf, None)
    settled: Mapping[str, Value] = {}
    variants = tuner.variants(law, problem.values)
    with tqdm.tqdm(total=times * budget * len(variants), desc=law.name, unit="sets") as bar:

        def told(done: int) -> None:
            bar.update(done)

        for variant in variants:
            there = problem._replace(values=updated(CONTROLLER, problem.values, variant))
            one = long_search(law, there, times * budget, seed, told)
            if one[0] < long[0]:
                long, settled = one, variant
    result: dict[str, Any] = {
        "seconds": seconds,
        "accepted": chosen.holds,
        "tuner": {"error": chosen.point.error, "chatter": chosen.point.chatter},
        "long_search": {"error": long[0]},
        "ratio": chosen.point.error / long[0],
    }
    if long[1] is not None:
        both = {"tuner": ({}, chosen.point.gains), "long_search": (settled, long[1])}
        for name, (variant, gains) in both.items():
            there = unseen._replace(values=updated(CONTROLLER, unseen.values, variant))
            (outcome,) = trial.run(law, there, [gains])
            result[name]["unseen"] = {"error": outcome.error, "chatter": outcome.chatter}
        errors = [result[name]["unseen"]["error"] for name in both]
        result["ratio_unseen"] = errors[0] / errors[1]
    return result


def main() -> int:
    """Compare, print, write."""
    options = argparse.ArgumentParser(prog="benchmarks.long_search", description=__doc__)
    options.add_argument("--budget", type=int, default=1000, help="sets of gains of the tuner (1000)")
    options.add_argument("--times", type=int, default=10, help="of that for the long search (10)")
    options.add_argument("--seed", type=int, default=1, help="of both (1)")
    options.add_argument("--only", choices=tuple(LAWS), action="append", help="one law; again for more")
    options.add_argument(
        "--json", default="out/long_search.json", metavar="FILE", help="(out/long_search.json)"
    )
    arguments = options.parse_args()
    Path(arguments.json).parent.mkdir(parents=True, exist_ok=True)
    found = {}
    for name in arguments.only or ("pid", "arc", "oarc", "dcarc"):
        found[name] = one = compared(LAWS[name], arguments.budget, arguments.times, arguments.seed)
        errors = [1e3 * one[who]["error"] for who in ("tuner", "long_search")]
        print(
            f"{name:8} tuner {errors[0]:.2f} mV in {one['seconds']:.0f} s (wanted {SECONDS:g}), "
            f"long search {errors[1]:.2f} mV: {one['ratio']:.3f} (wanted {WANTED:g}); "
            f"on unseen valves {one.get('ratio_unseen', math.nan):.3f}",
            flush=True,
        )
        outputs.write(arguments.json, outputs.as_json(found))
    print(f"wrote {arguments.json}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
