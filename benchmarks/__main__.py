# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks``: all benchmarks; exit status 1 if a wanted ratio is missed."""

import argparse
import signal
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks import axes, bags, batch, beside, handover, latency, start
from valve_control import interrupts, outputs

PARTS = ("batch", "axes", "start", "loop", "beside", "bags", "export")


def misses(figures: Mapping[str, float], wanted: Mapping[str, tuple[str, float]]) -> list[str]:
    """Figures that are not what is wanted, NaN included, in words."""
    found = []
    for name, (kind, bound) in wanted.items():
        value = figures[name]
        if not (value <= bound if kind == "at most" else value >= bound):
            found.append(f"{name} is {value:.3g}, wanted {kind} {bound:g}")
    return found


def main() -> int:
    """Run them."""
    options = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    options.add_argument("--seconds", type=float, default=300.0, help="length of the bags (300)")
    options.add_argument("--only", choices=PARTS, action="append", help="one part; again for more")
    options.add_argument("--out", default="out", metavar="FOLDER", help="output folder (out)")
    arguments = options.parse_args()
    status = interrupts.run(lambda: _measured(arguments), signal.SIGINT, signal.SIGTERM)
    if interrupts.come():
        print("\nstopped; no node is left running", file=sys.stderr)
    return status


def _measured(arguments: argparse.Namespace) -> int:
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"machine": batch.machine()}
    missed: list[str] = []
    with tempfile.TemporaryDirectory(prefix="valve_control-bench-") as name:
        folder = Path(name)
        parts: dict[str, tuple[Callable[[], dict[str, Any]], Mapping[str, tuple[str, float]]]] = {
            "batch": (lambda: batch.run(folder), batch.WANTED),
            "axes": (axes.run, axes.WANTED),
            "start": (start.run, start.WANTED),
            "loop": (lambda: latency.run(folder), latency.WANTED),
            "beside": (lambda: beside.run(folder), beside.WANTED),
            "export": (lambda: handover.run(folder), handover.WANTED),
            "bags": (lambda: bags.run(folder, arguments.seconds), bags.WANTED),
        }
        for part in arguments.only or PARTS:
            measure, wanted = parts[part]
            print(part, flush=True)
            try:
                found = measure()
            except (RuntimeError, ValueError, OSError) as error:
                if interrupts.come():
                    raise
                missed.append(f"{part}: {error}")
                continue
            figures = found.pop("figures")
            missed += misses(figures, wanted)
            results = {**figures, **results, part: found}
            print(flush=True)
    outputs.write(str(out / "bench.json"), outputs.as_json(results))
    print(f"wrote {out / 'bench.json'}")
    for text in missed:
        print(f"missed: {text}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
