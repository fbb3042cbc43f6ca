# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.lopsided``: cost of a dead zone and unequal gains to each law, with and without table.

``identify --friction`` measures a solenoid valve with a dead zone of ±0.3 V and gains 15 % apart. Its file
gives each law model and first gains, its characteristic curve the parameters ``linearisation.*``. The error
is that of the true position from the reference of the law, over the motions of ``compare`` that are known
ahead. The even valve is the same without dead zone and with equal gains, under the same law.
"""

import argparse
import contextlib
import io
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from research import coil, running
from research.coil import CoilValve
from valve_control.cli.common import write_json

if TYPE_CHECKING:
    from valve_control.parameter import Values

DEAD, SHARE = 0.3, 0.075  # V and -: edge of the dead zone, and what each side has more or less than the mean
VALVES = {
    "coil 0.3 ms": CoilValve(15.0, 0.8, 0.0003, 0.0, 0.0),
    "coil 3 ms": CoilValve(15.0, 0.8, 0.003, 0.0, 0.0),
    "coil 3 ms, hysteresis and friction": CoilValve(15.0, 0.8, 0.003, 0.1, 0.3),
}
LAWS: dict[str, "Values"] = {
    "open_loop": {"controller": "open_loop"},
    "compensator": {"controller": "compensator"},
    "pid": {"controller": "pid"},
    "arc": {"controller": "arc"},
    "oarc": {"controller": "oarc"},
    "dcarc": {"controller": "dcarc"},
    "dcarc, sides 0.15": {"controller": "dcarc", "dcarc.sides": 2.0 * SHARE},
}


class Error(NamedTuple):
    """One law on one valve."""

    sines: float  # V  geometric mean over the two motions with sines
    strokes: float  # V  likewise over those from point to point
    chatter: float  # -  mean c_u


def plant(valve: CoilValve, lopsided: bool) -> "Values":
    """Values of the simulator for ``valve``."""
    from valve_control.control.parameters.table import VALVE
    from valve_control.parameter import updated

    own: Values = {"solenoid.positive": 1.0, "flow_force": 0.0, "disturbance.offset": 0.0}
    if lopsided:
        own.update(
            {"solenoid.positive": 1.0 + SHARE, "solenoid.negative": 1.0 - SHARE, "solenoid.overlap": DEAD}
        )
    return updated(VALVE, coil.plant(valve), own)


def identified(valve: CoilValve, folder: Path) -> tuple["Values", "Values"]:
    """What ``identify`` writes for the controller of the lopsided ``valve``: its file, and its curve."""
    from valve_control import cli
    from valve_control.control.parameters import files

    sets = [
        word
        for name, value in plant(valve, True).items()
        if name.startswith(("solenoid.", "friction.", "lvdt."))
        or name in ("flow_force", "disturbance.offset")
        for word in ("--set", f"{name}={value}")
    ]
    model, curve = folder / "model.yaml", folder / "curve.yaml"
    words = [
        "--friction",
        "--order",
        "3",
        "--zeros",
        "0",
        "--output",
        str(model),
        "--characteristic",
        str(curve),
    ]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        status = cli.main(["identify", "--valve", "solenoid", *words, *sets])
    assert status == 0, "identify takes this valve"
    return files.load(str(model))["controller"], files.load(str(curve))["controller"]


def measured(given: "Values", valve: "Values") -> Error:
    """Run a controller of the ``given`` values on ``valve`` over all motions of ``compare``."""
    import numpy as np

    from research import comparison
    from valve_control.control.analysis.indices import rms
    from valve_control.control.laws.registry import LAWS as KNOWN
    from valve_control.control.parameters.table import CONTROLLER
    from valve_control.control.simulation import delivery, offline
    from valve_control.parameter import defaults, updated

    values = updated(CONTROLLER, defaults(CONTROLLER), {**given, **comparison.NO_LIMITS})
    law = KNOWN[str(values["controller"])]
    p = law.build(values)
    errors: dict[str, list[float]] = {"sine": [], "point": []}
    chatter = []
    for name, wanted in comparison.motions().items():
        sent = delivery.unreshaped(p.reshaping, wanted) if law.reshapes(p) else wanted[:-2]
        run = offline.simulate(values, valve, sent, alone=True)
        kind = "sine" if "sine" in name else "point"
        errors[kind].append(rms(run.position - run.terms["reference"]))
        chatter.append(run.indices.c_u)
    means = [float(np.exp(np.mean(np.log(part)))) for part in errors.values()]
    return Error(means[0], means[1], float(np.mean(chatter)))


def rows(valve: CoilValve) -> dict[str, dict[str, Error]]:
    """Errors of each of LAWS on the even valve, on the lopsided one, and there with the table."""
    with tempfile.TemporaryDirectory(prefix="valve_control-") as place:
        model, curve = identified(valve, Path(place))
    found = {}
    for name, law in LAWS.items():
        cases: dict[str, tuple[Values, bool]] = {
            "even": ({**model, **law}, False),
            "lopsided": ({**model, **law}, True),
            "table": ({**model, **law, **curve}, True),
        }
        found[name] = {case: measured(given, plant(valve, odd)) for case, (given, odd) in cases.items()}
    return found


def table(name: str, found: dict[str, dict[str, Error]]) -> list[str]:
    """Markdown: mV on sines / on strokes, and c_u, one row a law."""
    lines = [f"| {name} | even valve | dead zone, two gains | the same with the table |", "|---|---|---|---|"]
    for law, cases in found.items():
        cells = [f"{1e3 * e.sines:.1f} / {1e3 * e.strokes:.1f} ({e.chatter:.2f})" for e in cases.values()]
        lines.append(f"| {law} | {' | '.join(cells)} |")
    return lines


def _lopsided(arguments: argparse.Namespace) -> None:
    found: dict[str, Any] = {name: rows(valve) for name, valve in VALVES.items()}
    if arguments.json != "-":
        print("\n\n".join("\n".join(table(name, part)) for name, part in found.items()))
    as_dict = {
        name: {law: {c: e._asdict() for c, e in cases.items()} for law, cases in part.items()}
        for name, part in found.items()
    }
    write_json(arguments, as_dict)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement; returns the exit status."""
    options = running.options(
        "lopsided", "What a dead zone and unequal gains cost, with and without the table."
    )
    return running.run(options, _lopsided, argv)


if __name__ == "__main__":
    sys.exit(main())
