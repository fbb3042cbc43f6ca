"""``python -m benchmarks``: all benchmarks; exit status 1 if a wanted ratio is missed."""

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import bags, batch, latency, start
from valve_control import outputs

PARTS = ("batch", "start", "loop", "bags")


def main() -> int:
    """Run them."""
    options = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    options.add_argument("--seconds", type=float, default=300.0, help="length of the bags (300)")
    options.add_argument("--only", choices=PARTS, action="append", help="one part; again for more")
    options.add_argument("--out", default="out", metavar="FOLDER", help="output folder (out)")
    arguments = options.parse_args()
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"machine": batch.machine()}
    missed: list[str] = []
    with tempfile.TemporaryDirectory(prefix="valve_control-bench-") as name:
        folder = Path(name)
        parts: dict[str, tuple[Callable[[], dict[str, Any]], Callable[[dict[str, Any]], list[str]]]] = {
            "batch": (lambda: batch.run(folder), batch.missed),
            "start": (start.run, start.missed),
            "loop": (lambda: latency.run(folder), latency.missed),
            "bags": (lambda: bags.run(folder, arguments.seconds), bags.missed),
        }
        for part in arguments.only or PARTS:
            measure, judge = parts[part]
            print(part, flush=True)
            try:
                found = measure()
            except (RuntimeError, ValueError, OSError) as error:
                missed.append(f"{part}: {error}")
                continue
            results = {**found.pop("figures"), **results, part: found}
            missed += judge({**found, "figures": results})
            print(flush=True)
    outputs.write(str(out / "bench.json"), outputs.as_json(results))
    print(f"wrote {out / 'bench.json'}")
    for text in missed:
        print(f"missed: {text}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
