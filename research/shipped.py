# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.shipped``: the gains of config/tuned for two valves, on steps, at rest and on motions.

Prints the table of docs/explanation/laws/reshaping.md as Markdown.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from research import running
from valve_control.cli.common import Parser, write_json

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from valve_control.parameter import Values

VALVES = ("d3fxe", "d3fxe_experiment")
LAWS = ("arc", "oarc", "dcarc", "pid")
COMMANDS = ("fast_strokes", "sines", "slow_strokes")
LEVELS = (0.0, 1.0, 0.0, 2.5, 1.0)  # V  each is held for HELD; the step to 2.5 V is not judged
JUDGED = (0, 1, 3)  # steps between them
HELD = 1.0  # s


class Measured(NamedTuple):
    """One parameter file on the valve that it is shipped for."""

    overshoot: tuple[float, ...]  # -  of each judged step, true position
    rest: float  # V  rms error at a command of 0 V in the second and third second
    errors: tuple[float, ...]  # V  true e_rms on each of COMMANDS, command alone
    chatter: float  # -  largest c_u on them


def measured(valve_name: str, law_name: str, folder: Path | None = None) -> Measured:
    """The gains of ``law_name`` in ``folder`` (config/tuned) on the valve of config/``valve_name``.yaml.

    Raises ParameterError.
    """
    import numpy as np

    from valve_control.control.analysis import indices, steps
    from valve_control.control.parameters import files, ros_file
    from valve_control.control.parameters.table import NODES
    from valve_control.parameter import defaults, number, updated

    config = ros_file.config_folder()
    settings = {node: defaults(table) for node, table in NODES.items()}
    for path in (
        config / f"{valve_name}.yaml",
        (folder or config / "tuned") / f"{valve_name}_{law_name}.yaml",
    ):
        for node, changes in files.load(str(path)).items():
            settings[node] = updated(NODES[node], settings[node], changes)
    period = number(settings["controller"], "sample_period")
    held = round(HELD / period)
    levels = np.repeat(LEVELS, held)
    position, _ = _run(settings, levels)
    overshoot = []
    for i in JUDGED:
        part = slice(i * held, (i + 2) * held)
        answer = steps.answer(levels[part], position[part], period)
        overshoot.append(float(answer.overshoot) if answer else math.nan)
    still, _ = _run(settings, np.zeros(3 * held))
    errors, chatter = [], []
    for name in COMMANDS:
        wanted = np.loadtxt(config / "commands" / f"{name}.csv")
        found, voltage = _run(settings, wanted)
        told = indices.indices(found - wanted, voltage, period)
        errors.append(told.e_rms)
        chatter.append(told.c_u)
    return Measured(tuple(overshoot), indices.rms(still[held:]), tuple(errors), max(chatter))


def _run(
    settings: "dict[str, Values]", command: "npt.NDArray[np.float64]"
) -> "tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]":
    """True position and voltage [V] of one valve under a command [V]."""
    import numpy as np

    from valve_control.control.laws import command_lead
    from valve_control.control.laws.registry import LAWS as REGISTRY
    from valve_control.control.parameters import build
    from valve_control.control.simulation import batch
    from valve_control.parameter import word

    values = settings["controller"]
    law = REGISTRY[word(values, "controller")]
    params = law.build(values)
    led = command_lead.applied(command_lead.build(values, law.reshapes(params)), command)
    plants = batch.records([build.valve_params(settings["valve_simulator"])])
    traces = np.empty((1, len(command), 3))
    batch.simulate(batch.Batch(law.name, params, plants, np.array([1]), command, led=led), 1, traces)
    return traces[0, :, 0], traces[0, :, 2]


def table(found: dict[str, Measured]) -> list[str]:
    """Rows of Markdown, one for each parameter file."""
    heads = ["gains", "overshoot 0 → 1, 1 → 0, 2.5 → 1 V [%]", "at rest [mV]"]
    heads += ["fast strokes, sines, slow strokes [mV]", "$c_u$"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, one in found.items():
        overshoot = " / ".join(f"{100.0 * share:.1f}" for share in one.overshoot)
        errors = " / ".join(f"{1e3 * error:.1f}" for error in one.errors)
        lines.append(f"| `{name}` | {overshoot} | {1e3 * one.rest:.1f} | {errors} | {one.chatter:.2f} |")
    return lines


def _options() -> Parser:
    parser = running.options("shipped", "The gains of config/tuned on steps, at rest and on three motions.")
    parser.add_argument("--gains", metavar="FOLDER", help="gains in another folder than config/tuned")
    return parser


def _shipped(arguments: argparse.Namespace) -> None:
    folder = Path(arguments.gains) if arguments.gains else None
    found = {f"{v}_{law}.yaml": measured(v, law, folder) for v in VALVES for law in LAWS}
    if arguments.json != "-":
        print("\n".join(table(found)))
    write_json(arguments, {name: one._asdict() for name, one in found.items()})


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement; returns the exit status."""
    return running.run(_options(), _shipped, argv)


if __name__ == "__main__":
    sys.exit(main())
