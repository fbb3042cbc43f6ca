# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.interpolation``: commands at 100 Hz, joined in each way, beside commands at 1 kHz.

A sine of 1 V under PID and dcarc on the valve of config/d3fxe.yaml. Prints a table of docs/howto/cascade.md
as Markdown.
"""

import argparse
import cmath
import math
import sys
from collections.abc import Sequence
from typing import NamedTuple

from research import running
from valve_control.cli.common import Parser, write_json

LAWS = {"PID": "pid", "dcarc": "dcarc"}
FREQUENCIES = (1.0, 3.0, 5.0, 10.0)  # Hz
KINDS = ("hold", "linear", "extrapolate", "bridge")
SLOW = 0.01  # s  from one command to the next
SETTLED = 1000  # samples


class Outcome(NamedTuple):
    """The spool on a sine, after its beginning."""

    error: float  # V  true rms error
    lag: float  # s  from the command to the spool, by their phases at the frequency of the sine


def measured(law: str, frequency: float, kind: str = "hold", period: float = 0.0) -> Outcome:
    """``law`` with config/LAW.yaml on a sine of ``frequency`` [Hz]; commands each ``period`` [s], 0: 1 ms."""
    import numpy as np

    from valve_control.control.analysis.indices import rms
    from valve_control.control.parameters import build, files
    from valve_control.control.parameters.table import NODES
    from valve_control.control.simulation import offline
    from valve_control.control.simulation.delivery import Delivery
    from valve_control.parameter import defaults, number, updated

    config = files.config_folder()
    settings = {node: defaults(table) for node, table in NODES.items()}
    for path in (config / "d3fxe.yaml", config / f"{law}.yaml"):
        for node, given in files.load(str(path)).items():
            settings[node] = updated(NODES[node], settings[node], given)
    changes = {"controller": law, "command.interpolation": kind}
    settings["controller"] = updated(NODES["controller"], settings["controller"], changes)
    shape = {"scenario": "sine", "frequency": frequency, "amplitude": 1.0, "duration": 3.0, "start": 0.0}
    command = build.commands(updated(NODES["command_source"], settings["command_source"], shape))
    delivered = Delivery(period) if period > 0.0 else None
    run = offline.simulate(settings["controller"], settings["valve_simulator"], command, delivered=delivered)
    step = number(settings["controller"], "sample_period")
    cycle = 1.0 / (frequency * step)
    k = np.arange(len(command) - round(math.floor((len(command) - SETTLED) / cycle) * cycle), len(command))
    wave = np.exp(-2j * math.pi * frequency * step * k)
    behind = complex(np.dot(command[k], wave)) / complex(np.dot(run.position[k], wave))
    lag = cmath.phase(behind) / (2.0 * math.pi * frequency)
    return Outcome(rms((run.position - command)[SETTLED:]), lag)


def row(law: str, frequency: float) -> list[Outcome]:
    """Commands at 1 kHz, and at 100 Hz in each of ``KINDS``."""
    return [measured(law, frequency), *(measured(law, frequency, kind, SLOW) for kind in KINDS)]


def table(rows: dict[tuple[str, float], list[Outcome]]) -> list[str]:
    """Rows of Markdown."""
    heads = ["law", "frequency", "1 kHz", f"100 Hz, `{KINDS[0]}`", *(f"`{kind}`" for kind in KINDS[1:])]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for (name, frequency), found in rows.items():
        cells = (f"{1e3 * one.error:.0f} mV, {1e3 * one.lag:.1f} ms" for one in found)
        lines.append(f"| {name} | {frequency:.0f} Hz | " + " | ".join(cells) + " |")
    return lines


def _options() -> Parser:
    return running.options("interpolation", "Commands at 100 Hz, joined in each way, beside 1 kHz.")


def _compared(arguments: argparse.Namespace) -> None:
    rows = {(name, f): row(law, f) for name, law in LAWS.items() for f in FREQUENCIES}
    if arguments.json != "-":
        print("\n".join(table(rows)))
    write_json(arguments, {f"{law} {f:g} Hz": [one._asdict() for one in at] for (law, f), at in rows.items()})


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement; returns the exit status."""
    return running.run(_options(), _compared, argv)


if __name__ == "__main__":
    sys.exit(main())
