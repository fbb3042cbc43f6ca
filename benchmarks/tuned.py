# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.tuned``: every law at its best on random valves, at equal chatter, on four commands.

Each law is tuned on some of the valves of a box by the package's own search (valve_control/design/tuning),
all with the same number of trials, and measured on others. The commands are known ahead: those of laws that
reshape are made so that the reference is the wanted motion exactly; those of the plain PID are moved ahead
by a tuned time. On the wide box margins are conditions; the narrow one has no spread in speed and dead
time: none are asked for.
"""

import argparse
import itertools
import math
import sys
from pathlib import Path
from typing import Any

import tqdm

from research.comparison import (
    NOISE_SEED,
    Setup,
    made_of,
    measured,
    motions,
    summary,
    valves,
)
from valve_control import outputs
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters import ros_file
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.valve import NO_DISTURBANCE
from valve_control.control.simulation import batch
from valve_control.design.tuning import checks, trial, tuner
from valve_control.parameter import Value, defaults, updated, word

SEEDS = {"tune": 100, "verify": 555, "measure": 999, "check": 20261122}
VERIFIED_ON = 100
TUNED_ON = {"narrow": 12, "wide": 32}
SPREAD = (0.7, 1.4), (0.8, 1.25), (0.8, 1.25), (-0.5, 0.5), (0.0, 1e-3)  # of what margins depend on
MARGINS = trial.USUAL
NO_MARGINS = trial.TuningLimits(0.0, 0.0, 0.0, 200.0, math.inf, 1.0, 0.0)
MOST_FRICTION = NO_DISTURBANCE._replace(coulomb=1.6, presliding=0.04)  # of the box


# What is not tuned of each law.
FIXED: dict[str, dict[str, Value]] = {
    "pid_plain": {"controller": "pid", "pid.form": "plain"},
    "pid_reference": {"controller": "pid", "pid.form": "reference"},
    "arc": {"controller": "arc"},
    "oarc": {"controller": "oarc"},
    "dcarc": {"controller": "dcarc"},
}


def shared(share: float) -> trial.TuningLimits:
    """MARGINS times ``share``; a peak in decibels is divided by it."""
    return trial.TuningLimits(
        share * MARGINS.gain_db,
        share * MARGINS.phase_deg,
        share * MARGINS.delay_s,
        MARGINS.sensitivity_db / share,
        MARGINS.swing / share,
        MARGINS.saturated,
        MARGINS.pause_s,
    )


def corners() -> list[valve.Params]:
    """Corners of the wide box, as far as margins depend on it."""
    return [
        made_of(gain, poles, zeros, delay, MOST_FRICTION._replace(flow_force=flow))
        for gain, poles, zeros, flow, delay in itertools.product(*SPREAD)
    ]


def problem_of(name: str, wide: bool, limits: trial.TuningLimits) -> trial.Problem:
    """What the search sees of the law ``name``."""
    delay: dict[str, Value] = {"dcarc.delay": 5e-4} if wide and name == "dcarc" else {}
    values = updated(CONTROLLER, defaults(CONTROLLER), {**FIXED[name], **delay})
    plants = valves(TUNED_ON["wide" if wide else "narrow"], SEEDS["tune"], wide)
    return trial.Problem(
        values=values,
        motions=[trial.TuningMotion(text, wanted[:-2]) for text, wanted in motions().items()],
        plants=plants,
        box=[*corners(), *plants] if wide else plants,
        limits=limits,
        preview=True,
        seed=0,
    )


def main() -> int:
    """Tune, measure, write."""
    options = argparse.ArgumentParser(prog="benchmarks.tuned", description=__doc__)
    options.add_argument("--box", choices=tuple(TUNED_ON), default="narrow", help="of valves (narrow)")
    options.add_argument("--limit", type=float, default=0.25, help="of the mean chatter c_u (0.25)")
    options.add_argument("--trials", type=int, default=1500, help="sets of gains tried of each law (1500)")
    options.add_argument("--valves", type=int, default=200, help="measured on (200)")
    options.add_argument("--check", type=int, default=0, help="more valves, for limit cycles alone (0)")
    options.add_argument(
        "--margins", type=float, default=1.0, help="share of the margins asked for on the wide box (1)"
    )
    options.add_argument("--only", choices=tuple(FIXED), action="append", help="one law; again for more")
    options.add_argument("--threads", type=int, help="(all cores)")
    options.add_argument("--out", default="out/tuned", metavar="FOLDER", help="output folder (out/tuned)")
    arguments = options.parse_args()
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    wide = arguments.box == "wide"
    share = f" --margins {arguments.margins:g}" if wide and arguments.margins != 1.0 else ""
    limits = shared(arguments.margins) if wide else NO_MARGINS
    for name in arguments.only or FIXED:
        problem = problem_of(name, wide, limits)
        law = LAWS[word(problem.values, "controller")]
        unseen = problem._replace(plants=valves(VERIFIED_ON, SEEDS["verify"], wide), seed=SEEDS["verify"])
        with tqdm.tqdm(total=arguments.trials, desc=name, unit="sets") as bar:

            def told(done: int, bar: Any = bar) -> None:
                bar.update(done - bar.n)

            found = tuner.tuned(
                law,
                problem,
                unseen,
                arguments.limit,
                arguments.trials,
                1,
                told,
                arguments.threads,
            )
        chosen, gains = found.chosen, found.chosen.point.gains
        values = tuner.parameters_of(law.name, problem.values, chosen)
        unused = valves(arguments.valves, SEEDS["measure"], wide)
        errors = summary(measured(Setup(name, values, gains.ahead), batch.records(unused), NOISE_SEED))
        swinging = checks.after_all(law, problem, gains, unused, arguments.threads)
        checked = valves(arguments.check, SEEDS["check"], wide)
        moving = checks.after_all(law, problem, gains, checked, arguments.threads)
        left = [checked[i] for i in moving]
        lasting = checks.LASTING
        cycles = moving[checks.after_all(law, problem, gains, left, arguments.threads, lasting)]
        stem = f"{arguments.box}_{arguments.limit:g}_{name}"
        about = [
            f"python -m benchmarks.tuned --box {arguments.box} --limit {arguments.limit:g} "
            f"--trials {arguments.trials}{share} --only {name}",
            f"on {len(problem.plants)} valves; margins in the box: {_margins_text(wide, limits)}",
        ]
        outputs.write(str(out / f"{stem}.yaml"), ros_file.as_yaml({"/**/controller": values}, about))
        result = {
            "law": name,
            "preview_s": gains.ahead,
            "trials": found.tried,
            "unusable": found.missed,
            "valves": arguments.valves,
            **errors,
            "not_at_rest_after_1_s": len(swinging),
            "margins": margins.as_dict(margins.worst(chosen.verified.margins)),
            "checked": {
                "valves": arguments.check,
                "limit_cycles": len(cycles),
                "which": cycles.tolist(),
                "not_at_rest_after_1_s": moving.tolist(),
            },
            "reasons": chosen.verified.reasons,
        }
        outputs.write(str(out / f"{stem}.json"), outputs.as_json(result))
        medians, tails = errors["median"], errors["95th percentile"]
        cells = "".join(f"{medians[key]:8.1f}" for key in medians)
        print(
            f"{name:14}{cells}   95 %: {tails['geometric mean']:7.1f}   c_u {errors['c_u']:.3f}   "
            f"limit cycles {len(cycles)} of {arguments.check}, not at rest after 1 s {len(swinging)} of "
            f"{arguments.valves}, {len(moving)} of {arguments.check}   {'; '.join(chosen.verified.reasons)}",
            flush=True,
        )
    return 0


def _margins_text(wide: bool, limits: trial.TuningLimits) -> str:
    if not wide:
        return "none asked for"
    return f"{limits.gain_db:g} dB, {limits.phase_deg:g} deg, {1e3 * limits.delay_s:g} ms"


if __name__ == "__main__":
    sys.exit(main())
