# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.delta``: a published axis of Delta Computer Systems under five valves."""

import argparse
import sys
from collections.abc import Sequence

from tqdm import tqdm

from research import running
from research.axes import delta, study
from valve_control.cli.common import check_outputs, write_json


def _study(arguments: argparse.Namespace) -> None:
    check_outputs(arguments)
    alone = delta.published(delta.Case(delta.NONE))
    with tqdm(total=len(study.VALVES) * len(delta.POLES), unit="pole") as bar:
        found = delta.study_valves(done=lambda: bar.update())
    if arguments.json != "-":
        print("largest error [mm] of a move of 500 mm: K, ζ, ω exact, 10 % low, worst corner of ±10 %")
        print("                      poles [rad/s]  lead [ms]     exact   all low     worst")
        for name, label, r in [
            (delta.NONE, "published", alone),
            *((name, "published", results[0]) for name, results in found.items()),
            *((name, "own", results[1]) for name, results in found.items()),
        ]:
            print(
                f"{name:<11}{label:<11}{r.pole:>13.1f}{1e3 * r.lead:>11.0f}"
                f"{_mm(r.nominal)}{_mm(r.low)}{_mm(r.worst)}"
            )
    write_json(
        arguments,
        {
            "published": alone._asdict(),
            "valves": {
                name: {"published": first._asdict(), "own": second._asdict()}
                for name, (first, second) in found.items()
            },
        },
    )


def _mm(error: float) -> str:
    return f"{1e3 * error:>10.4f}" if error < 0.5 else f"{'unstable':>10}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns the exit status."""
    options = running.options("delta", "Place the poles of a published axis under five valves.")
    return running.run(options, _study, argv)


if __name__ == "__main__":
    sys.exit(main())
