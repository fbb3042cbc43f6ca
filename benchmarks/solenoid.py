# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.solenoid``: commissioned laws against the best PID on random solenoid valves.

Each valve is drawn from a box by its seed and commissioned without ROS, once with dcarc and once with pid.
The parameters that this leaves are run on the valve itself, on the four motions of the comparison of tuned
laws. They are compared with the better of two forms of the PID whose gains CMA-ES finds on the same valve,
with the same limit of the chatter. A refused law has no ratio; its reason is listed.
"""

import argparse
import functools
import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.supervised import SupervisedValve
from research import comparison, running
from valve_control import outputs
from valve_control.cli import common
from valve_control.cli.common import CHATTER
from valve_control.control.compiling import sources_digest
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, NODES, VALVE
from valve_control.control.plant import registry
from valve_control.control.plant.transfer_functions import scale_of
from valve_control.control.simulation import batch
from valve_control.control.simulation.robustness import Quantity
from valve_control.design.commissioning import model, sequence
from valve_control.design.commissioning.bench import Fault, Plan, SafetyLimits, check
from valve_control.design.commissioning.valve_fit import EXPLAINED
from valve_control.design.tuning import box, checks, limits, search, trial
from valve_control.design.tuning.trial import GainSet, Problem, TuningMotion
from valve_control.parameter import ParameterError, Value, Values, defaults, number, updated, word

Array = npt.NDArray[np.float64]
DEVELOPMENT, UNSEEN = 1, 1000  # first seeds: those below UNSEEN may be developed with, the others not
STROKE = 20.0  # V  full stroke, of which hysteresis is a share
DRAWN = (
    ("natural_frequency", 5.0, 60.0),  # Hz, logarithmic
    ("damping", 0.5, 1.2),
    ("coil", 0.0005, 0.006),  # s
    ("hysteresis", 0.0, 0.04),  # of the full stroke
    ("side", 0.9, 1.1),  # gain of the positive side over that of the other
    ("coulomb", 0.0, 1.4),  # V
    ("presliding", 0.005, 0.04),  # V
    ("offset", -0.3, 0.3),  # V
    ("flow_force", 0.0, 0.15),  # V/V
    ("dead_time", 0.0, 0.0015),  # s
    ("actuator", 0.0, 1.0),  # share of the dead time that is the amplifier's; the rest is the LVDT's
    ("noise", 0.001, 0.006),  # V
    ("hum", 0.0, 0.005),  # V
)
BITS = (12, 16)
LIMITS = SafetyLimits(4.0, 2.0)
VALVES_SIMULATED, VALVES_UNSEEN = 6, 32  # of a commissioning, as by default
BEFORE: dict[str, Value] = {"lvdt.max_rate": 500.0}
SWING = 20.0  # V  the largest motion that can be believed, as a sine of the valve's natural frequency
MODES = {"with preview": True, "command alone": False}
FORMS: dict[str, dict[str, Value]] = {
    "plain": {"pid.form": "plain", "pid.break_frequency": 0.0},
    "reference": {"pid.form": "reference", "pid.break_frequency": 0.0},
}
# Of each motion the part in which it repeats itself, which is enough for a search.
SEARCHED = (2.0, 2.5, 2.0, 3.0)  # s
POPULATION, STEP, AGAIN = 20, 0.25, 0.08
NOISE_SEED = comparison.NOISE_SEED
WHERE = ("none", "valve", "box")  # margins of commissioning: nowhere, on the valve, on those around it too
MISSED, MISSING = 0.3, 3.0  # logarithm of the error for margins that are missed, and for each that is
LAWS_COMMISSIONED = ("dcarc", "pid")
ROBUST = {
    "stable": "are stable on their valve without friction",
    "margins": "keep the margins of commissioning there",
    "stable_around": "are stable on valves with 10 % more or less gain and speed",
    "margins_around": "keep the margins on those",
}


class Options(NamedTuple):
    """What a result depends on, beside the seed of its valve and the sources."""

    budget: int  # sets of gains of a commissioning
    sets: int  # of gains, in each search of the reference
    margins: str = "none"  # that the best PID keeps: of WHERE


def drawn(seed: int) -> Values:
    """Parameters of the simulator for the valve with this ``seed``."""
    random = np.random.default_rng(seed)
    share = {name: (low, high, float(random.uniform())) for name, low, high in DRAWN}
    d = {name: low + part * (high - low) for name, (low, high, part) in share.items()}
    low, high, part = share["natural_frequency"]
    d["natural_frequency"] = low * (high / low) ** part
    own: dict[str, Value] = {
        "valve": "solenoid",
        "seed": seed,
        "solenoid.natural_frequency": d["natural_frequency"],
        "solenoid.damping": d["damping"],
        "solenoid.coil": d["coil"],
        "solenoid.hysteresis": d["hysteresis"] * STROKE,
        "solenoid.positive": d["side"],
        "solenoid.dead_time": d["actuator"] * d["dead_time"],
        "solenoid.hum": d["hum"],
        "solenoid.bits": int(random.integers(BITS[0], BITS[1] + 1)),
        "flow_force": d["flow_force"],
        "disturbance.offset": d["offset"],
        "friction.coulomb": d["coulomb"],
        "friction.presliding": d["presliding"],
        "friction.static_ratio": 1.3,
        "friction.stribeck_velocity": 0.02,
        "lvdt.noise": d["noise"],
        "lvdt.resolution": 0.0,
        "lvdt.delay": (1.0 - d["actuator"]) * d["dead_time"],
    }
    return updated(VALVE, defaults(VALVE), own)


def on_the_valve(plant: Any, values: Mapping[str, Value], ahead: float, previewed: bool) -> dict[str, float]:
    """True e_rms [V] and c_u over the four motions, of a controller with ``values``.

    ``ahead`` [s]: by which a command that is known ahead is sent earlier to a law that does not reshape.
    """
    setup = comparison.Setup("", dict(values), ahead)
    found = comparison.measured(setup, batch.records([plant]), NOISE_SEED, previewed)
    return {"e_rms": comparison.geometric(found.rms), "c_u": float(np.mean(found.chatter))}


def searched(values: Values, form: str, previewed: bool, options: Options) -> GainSet:
    """Gains of the PID in this ``form`` that CMA-ES finds on the valve itself, which has these ``values``."""
    law, seed, plant = LAWS["pid"], int(number(values, "seed")), build.valve_params(values)
    around = {"none": [], "valve": [plant], "box": [plant, *surroundings(values)]}[options.margins]
    prepared = margins.prepared(around) if around else None
    own = {**comparison.NO_LIMITS, "controller": "pid", **FORMS[form]}
    cut = [round(seconds / comparison.PERIOD) for seconds in SEARCHED]
    problem = Problem(
        values=updated(CONTROLLER, defaults(CONTROLLER), own),
        motions=[
            TuningMotion(name, wanted[:n])
            for (name, wanted), n in zip(comparison.motions().items(), cut, strict=True)
        ],
        plants=[plant],
        box=around,
        limits=trial.USUAL,
        preview=previewed,
        seed=seed,
        scale=scale_of(registry.chosen(values).model(values)),
    )
    free = trial.free_numbers(law, problem.values, previewed, problem.scale)
    best, least, tried = np.full(len(free), 0.5), math.inf, 0
    step = STEP
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while tried < options.sets:
            strategy = search.strategy(best, step, seed + tried + 1, POPULATION)
            while tried < options.sets and not strategy.stop():
                asked = strategy.ask()
                costs = _costs(law, problem, free, asked, prepared)
                strategy.tell(asked, costs)
                tried += len(asked)
                if min(costs) < least:
                    best, least = np.clip(asked[int(np.argmin(costs))], 0.0, 1.0), min(costs)
            step = AGAIN
    return trial.gains_at(free, problem.values, [float(v) for v in best])


def _costs(
    law: Any, problem: Problem, free: Any, asked: Sequence[Array], prepared: margins.Box | None
) -> list[float]:
    """What the search of the reference makes small; ``prepared``: the valves on which margins hold."""
    inside = [np.clip(shares, 0.0, 1.0) for shares in asked]
    gains = [trial.gains_at(free, problem.values, [float(v) for v in shares]) for shares in inside]
    found = []
    for shares, within, one, outcome in zip(
        asked, inside, gains, trial.run(law, problem, gains, 1), strict=True
    ):
        with np.errstate(divide="ignore", invalid="ignore"):
            point = search.EvaluatedGains(tuple(within), one, outcome.error, outcome.chatter, 0.0)
            cost = search.cost(point, CHATTER, 1.0)
        outside = float(np.sum((shares - within) ** 2))
        if prepared is not None:
            params = law.build(trial.values_with(problem, one))
            missing = limits.violation(problem.limits, margins.margins(law, params, prepared))
            outside += MISSING * missing + (MISSED if missing > 0.0 else 0.0)
        found.append((cost if math.isfinite(cost) else search.NOT_RUN) + outside)
    return found


def reference(values: Values, options: Options, kept: Mapping[str, Any] | None) -> dict[str, Any]:
    """The better of both forms of the PID on the valve with ``values``, by mode.

    ``kept``: what was found before, which counts as long as its gains still give the same figures.
    """
    plant = build.valve_params(values)
    if kept is not None and all(
        _measured_again(plant, kept[mode], previewed) for mode, previewed in MODES.items()
    ):
        return dict(kept)
    found: dict[str, Any] = {}
    began = time.process_time()
    for mode, previewed in MODES.items():
        for form in FORMS:
            gains = searched(values, form, previewed, options)
            own = {**comparison.NO_LIMITS, "controller": "pid", **FORMS[form], **gains.changes}
            one = {"form": form, "values": own, "ahead": gains.ahead}
            one.update(on_the_valve(plant, own, gains.ahead, previewed))
            if mode not in found or _better(one, found[mode]):
                found[mode] = one
    found["cpu_s"] = time.process_time() - began
    return found


def surroundings(values: Values) -> list[Any]:
    """Valves around that with ``values``, as far from it as those that commissioning has in its box."""
    coulomb, offset = number(values, "friction.coulomb"), number(values, "disturbance.offset")
    late = number(values, "lvdt.delay")
    quantities = [
        Quantity("gain", 1.0 - model.SPREAD, 1.0 + model.SPREAD, "-"),
        Quantity("speed", 1.0 - model.SPREAD, 1.0 + model.SPREAD, "-"),
        Quantity("disturbance.offset", offset - model.OFFSET, offset + model.OFFSET, "V"),
        Quantity("lvdt.delay", late, late + model.LATER * comparison.PERIOD, "s"),
        Quantity("friction.coulomb", (1.0 - model.RUBBING) * coulomb, (1.0 + model.RUBBING) * coulomb, "V"),
    ]
    settings = {name: defaults(NODES[name]) for name in ("controller", "command_source")}
    settings["valve_simulator"] = values
    return box.bounding(box.study_of(settings, quantities, 1, DEVELOPMENT))


def robustness(values: Values, found: Mapping[str, Any]) -> dict[str, dict[str, bool]]:
    """Of each of the best PIDs ``found``, by mode, what it keeps on the valve without friction and around it.

    Whether it is ``stable`` there, keeps the ``margins`` of commissioning, is stable on all the surroundings
    (``stable_around``), and keeps the margins on all of them (``margins_around``).
    """
    law = LAWS["pid"]
    valves = {"": margins.prepared([build.valve_params(values)])}
    valves["_around"] = margins.prepared(surroundings(values))
    kept: dict[str, dict[str, bool]] = {}
    for mode in MODES:
        params = law.build(updated(CONTROLLER, defaults(CONTROLLER), found[mode]["values"]))
        kept[mode] = {}
        for where, prepared in valves.items():
            there = margins.margins(law, params, prepared)
            kept[mode][f"stable{where}"] = bool(np.max(there.radius) < 1.0 + margins.EDGE)
            kept[mode][f"margins{where}"] = limits.violation(trial.USUAL, there) == 0.0
    return kept


def _better(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether ``one`` keeps the limit of the chatter and the ``other`` does not, or has less error."""
    quiet = [bool(each["c_u"] <= CHATTER) for each in (one, other)]
    return quiet[0] if quiet[0] != quiet[1] else bool(one["e_rms"] < other["e_rms"])


def _measured_again(plant: Any, one: Mapping[str, Any], previewed: bool) -> bool:
    now = on_the_valve(plant, one["values"], one["ahead"], previewed)
    return all(math.isclose(now[name], one[name], rel_tol=1e-9) for name in now)


class _Steps:
    """Goes on, and remembers the latest step."""

    def __init__(self) -> None:
        self.step = "limits"
        self.refusals: list[str] = []

    def confirm(self, text: str) -> bool:
        return True

    def progress(self, name: str, done: float, total: float) -> None:
        self.step = name

    def tested(self, records: sequence.Records) -> None:
        pass

    def fitted(self, valve: Values) -> None:
        pass

    def refused(self, changes: Values, reason: str) -> None:
        self.refusals.append(reason)


def commissioned(
    values: Values, law: str, options: Options, tests: sequence.Tests | None = None
) -> tuple[dict[str, Any], sequence.Tests | None]:
    """What commissioning of ``law`` leaves on the valve with ``values``, and what that does there.

    ``tests`` of the valve that another law has made are not made again; they are returned.
    """
    fastest = max(500.0, 2.0 * math.pi * number(values, "solenoid.natural_frequency") * SWING)
    bench = SupervisedValve(values, {**BEFORE, "lvdt.max_rate": fastest})
    plan = Plan(
        LIMITS, law, CHATTER, options.budget, VALVES_SIMULATED, VALVES_UNSEEN, seed=1, threads=1, firm=False
    )
    before, steps = bench.values(), _Steps()
    check(plan, before)
    began = time.process_time()
    try:
        with sequence.reversible(bench, before, sequence.Reversal()):
            result = sequence.Commissioning(bench, plan, before, steps).run(tests)
    except (ParameterError, Fault) as error:
        cpu = time.process_time() - began
        return {"accepted": False, "reason": str(error), "step": steps.step, "cpu_s": cpu}, tests
    told = sequence.as_dict(result)
    after = bench.values()
    plant = bench.params
    cpu = time.process_time() - began
    running_c_u = float(told["verification"]["measured"]["c_u"])
    modes = {
        mode: on_the_valve(plant, after, number(after, "reshaping.lead"), previewed)
        for mode, previewed in MODES.items()
    }
    made = {
        "accepted": True,
        "cpu_s": cpu,
        "seconds": told["seconds"],
        "applied": told["applied"],
        "valve": told["valve"],
        "verification": told["verification"],
        "running_c_u": running_c_u,
        "modes": modes,
        "limit_cycle": cycles(plant, after),
        "refusals": steps.refusals,
        "notes": told["notes"],
    }
    return made, result.tests


def cycles(plant: Any, values: Values) -> bool:
    """Whether the loop still swings on the valve long after a step or a motion."""
    law = LAWS[word(values, "controller")]
    motions = [TuningMotion(name, wanted[:-2]) for name, wanted in comparison.motions().items()]
    problem = Problem(values, motions, [plant], [plant], trial.USUAL, False, NOISE_SEED)
    return len(checks.after_all(law, problem, GainSet({}, 0.0), [plant], 1, checks.LASTING)) > 0


def gone_through(folder: Path, seed: int, options: Options) -> dict[str, Any]:
    """The valve ``seed``; what ``folder`` has of it is not done again, unless sources have changed."""
    path = folder / f"{seed}.json"
    asked = {**options._asdict(), "seed": seed}
    kept = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if {"margins": WHERE[0], **kept.get("options", {})} != asked:  # older files have no margins
        kept = {}
    values = drawn(seed)
    row: dict[str, Any] = {"options": asked, "sources": sources_digest(), "valve": values}

    def keep() -> None:
        outputs.write(str(path), outputs.as_json(row))

    row["reference"] = reference(values, options, kept.get("reference"))
    row["robustness"] = robustness(values, row["reference"])
    row["laws"] = {} if kept.get("sources") != row["sources"] else dict(kept["laws"])
    tests: sequence.Tests | None = None
    for law in LAWS_COMMISSIONED:
        keep()
        if law not in row["laws"]:
            row["laws"][law], tests = commissioned(values, law, options, tests)
    keep()
    return row


def ratio(row: Mapping[str, Any], law: str, mode: str) -> float:
    """Error of the commissioned ``law`` over that of the best PID; NaN: refused."""
    made = row["laws"][law]
    if not made["accepted"]:
        return math.nan
    return float(made["modes"][mode]["e_rms"] / row["reference"][mode]["e_rms"])


def loudest(row: Mapping[str, Any], law: str) -> float:
    """Largest c_u of verification run and motions over its limit; NaN: refused."""
    made = row["laws"][law]
    if not made["accepted"]:
        return math.nan
    return float(max(made["running_c_u"], *(made["modes"][mode]["c_u"] for mode in MODES))) / CHATTER


class Target(NamedTuple):
    """One thing that is asked for."""

    name: str
    value: float
    bound: float
    least: bool = False  # whether ``bound`` is the least value, not the largest

    @property
    def reached(self) -> bool:
        """NaN is not."""
        return self.value >= self.bound if self.least else self.value <= self.bound


def targets(rows: Sequence[Mapping[str, Any]]) -> list[Target]:
    """What issue 32 asks for. Ratios are those of accepted laws."""
    found = []
    for law, median, worst in (("dcarc", 0.5, 1.0), ("pid", math.nan, 1.3)):
        for mode in MODES:
            ratios = [r for row in rows if math.isfinite(r := ratio(row, law, mode))] or [math.nan]
            if math.isfinite(median):
                found.append(Target(f"{law}, {mode}: median ratio", float(np.median(ratios)), median))
            found.append(Target(f"{law}, {mode}: largest ratio", max(ratios), worst))
    made = [row["laws"]["dcarc"] for row in rows]
    accepted = [one for one in made if one["accepted"]]
    loud = [c for row in rows if math.isfinite(c := loudest(row, "dcarc"))] or [math.nan]
    explained = sum(one["valve"]["error"] <= EXPLAINED for one in accepted)
    found.append(Target("dcarc: largest c_u over its limit", max(loud), 1.3))
    found.append(
        Target(
            f"share of valves with a model error of {EXPLAINED:g} or less", explained / len(made), 0.9, True
        )
    )
    found.append(Target("dcarc: limit cycles", float(sum(one["limit_cycle"] for one in accepted)), 0.0))
    found.append(Target("dcarc: share of valves accepted", len(accepted) / len(made), 1.0, True))
    return found


HEAD = (
    f"{'valve':>6}{'f [Hz]':>8}{'coil':>6}{'hyst.':>6}{'frict.':>7}{'best PID [mV]':>15}"
    f"{'dcarc':>14}{'pid':>14}{'c_u':>6}{'model':>7}{'cycle':>6}{'CPU [s]':>9}"
)


def told(row: Mapping[str, Any]) -> list[str]:
    """Lines of the table for one valve: ratios with preview and with the command alone."""
    valve, made = row["valve"], row["laws"]["dcarc"]

    def both(figures: Sequence[float], form: str) -> str:
        return "/".join("-" if math.isnan(f) else format(f, form) for f in figures)

    best = both([1e3 * row["reference"][mode]["e_rms"] for mode in MODES], ".1f")
    ratios = [both([ratio(row, law, mode) for mode in MODES], ".2f") for law in LAWS_COMMISSIONED]
    loud = loudest(row, "dcarc")
    cpu = sum(one["cpu_s"] for one in (row["reference"], *row["laws"].values()))
    line = (
        f"{row['options']['seed']:6}{valve['solenoid.natural_frequency']:8.1f}"
        f"{1e3 * valve['solenoid.coil']:6.1f}{valve['solenoid.hysteresis']:6.2f}"
        f"{valve['friction.coulomb']:7.2f}{best:>15}{ratios[0]:>14}{ratios[1]:>14}"
        + (f"{'-':>6}" if math.isnan(loud) else f"{loud:6.2f}")
        + (
            f"{made['valve']['error']:7.2f}{made['limit_cycle']!s:>6}"
            if made["accepted"]
            else f"{'-':>7}{'-':>6}"
        )
        + f"{cpu:9.0f}"
    )
    refused = [
        f"       {law} refused in step '{one['step']}': {one['reason']}"
        for law, one in row["laws"].items()
        if not one["accepted"]
    ]
    return [line, *refused]


def summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The targets as a table."""
    lines = [f"{'target':56}{'measured':>10}{'wanted':>12}"]
    for target in targets(rows):
        sign = "≥" if target.least else "≤"
        verdict = "reached" if target.reached else "NOT reached"
        lines.append(f"{target.name:56}{target.value:10.3f}{f'{sign} {target.bound:g}':>12}  {verdict}")
    whole = [one for row in rows for one in row["robustness"].values()]
    lines += [
        f"best PIDs that {text}: {sum(one[name] for one in whole)} of {len(whole)}"
        for name, text in ROBUST.items()
    ]
    return lines


def check_seeds(first: int, count: int) -> None:
    """Raise ParameterError for valves that are not all of development, or all unseen."""
    if not 1 <= count <= UNSEEN - 1:
        raise ParameterError(f"--valves is {count}; it must lie between 1 and {UNSEEN - 1}")
    if not 1 <= first < 2**31 - count:
        raise ParameterError(f"--seed is {first}; it must be 1 or more, and below 2³¹")
    if first < UNSEEN <= first + count - 1:
        raise ParameterError(
            f"--seed {first} --valves {count} reaches from the valves of development to the unseen ones, "
            f"which begin at {UNSEEN}; give one kind"
        )


def _options() -> common.Parser:
    parser = common.Parser(prog="python -m benchmarks.solenoid", description=__doc__)
    parser.add_argument("--valves", type=int, default=6, metavar="N", help="number of valves (6)")
    parser.add_argument(
        "--seed", type=int, default=DEVELOPMENT, metavar="N",
        help=f"of the first valve ({DEVELOPMENT}); from {UNSEEN} on nobody has developed with them",
    )  # fmt: skip
    parser.add_argument("--budget", type=int, default=200, metavar="N", help="of a commissioning (200)")
    parser.add_argument("--sets", type=int, default=1000, metavar="N", help="of the best PID's gains (1000)")
    parser.add_argument(
        "--margins", choices=WHERE, default=WHERE[0],
        help="of commissioning, that the best PID keeps: none, on its valve, or on a box of valves around it",
    )  # fmt: skip
    jobs = common.within(1, common.MOST_THREADS)
    parser.add_argument("--jobs", type=jobs, default=1, metavar="N", help="valves at a time (1)")
    parser.add_argument("--out", default="out/solenoid", metavar="FOLDER", help="(out/solenoid)")
    return parser


def _solenoid(arguments: argparse.Namespace) -> None:
    check_seeds(arguments.seed, arguments.valves)
    for name in ("budget", "sets"):
        if not 1 <= getattr(arguments, name) <= 10**6:
            raise ParameterError(f"--{name} is {getattr(arguments, name)}; it must lie between 1 and 1000000")
    folder = Path(arguments.out)
    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(arguments.seed, arguments.seed + arguments.valves)
    work = functools.partial(
        gone_through, folder, options=Options(arguments.budget, arguments.sets, arguments.margins)
    )
    rows: list[dict[str, Any]] = []
    began = time.monotonic()
    print(HEAD, flush=True)

    def done(row: dict[str, Any]) -> None:
        rows.append(row)
        print("\n".join(told(row)), flush=True)
        left = (time.monotonic() - began) / len(rows) * (len(seeds) - len(rows))
        end = time.strftime("%H:%M", time.localtime(time.time() + left))
        print(f"{len(rows)} of {len(seeds)} valves, end about {end}", file=sys.stderr, flush=True)

    _each(work, seeds, arguments.jobs, done)
    print()
    print("\n".join(summary(rows)))
    path = folder / "solenoid.json"
    result = {
        "valves": len(rows),
        "unseen": arguments.seed >= UNSEEN,
        "targets": [{**target._asdict(), "reached": target.reached} for target in targets(rows)],
        "rows": rows,
    }
    outputs.write(str(path), outputs.as_json(result))
    print(f"wrote {path}")


def _each(
    work: Callable[[int], dict[str, Any]],
    seeds: Sequence[int],
    jobs: int,
    done: Callable[[dict[str, Any]], None],
) -> None:
    """``done`` with what ``work`` makes of each of ``seeds``, in their order."""
    if jobs == 1:
        for seed in seeds:
            done(work(seed))
        return
    with running.pool(jobs) as pool:
        for row in pool.map(work, seeds):
            done(row)


def main(argv: Sequence[str] | None = None) -> int:
    """Go through the valves, print, write; returns the exit status."""
    return running.run(_options(), _solenoid, argv)


if __name__ == "__main__":
    sys.exit(main())
