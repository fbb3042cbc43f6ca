"""``python -m benchmarks``: all benchmarks; exit status 1 if a wanted ratio is missed."""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks import bags, batch
from valve_control import outputs


def main() -> int:
    """Run them."""
    options = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    options.add_argument("--seconds", type=float, default=300.0, help="length of the bags (300)")
    options.add_argument("--only", choices=("batch",), help="batches alone, without bags")
    options.add_argument("--out", default="out", metavar="FOLDER", help="output folder (out)")
    arguments = options.parse_args()
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="valve_control-bench-") as folder:
        results: dict[str, Any] = {"machine": batch.machine(), "bags": {}}
        missed = []
        try:
            batches = batch.run(Path(folder))
            results = {**batches["figures"], **results, "batch": batches}
            missed += batch.missed(batches)
        except batch.BenchmarkError as error:
            missed.append(f"batches: {error}")
        if arguments.only != "batch":
            results["bags"] = bags.run(Path(folder), arguments.seconds)
    outputs.write(str(out / "bench.json"), outputs.as_json(results))
    print(f"\nwrote {out / 'bench.json'}")
    missed += [
        name
        for name, entry in results["bags"].items()
        if entry["ratio"] < entry["wanted_ratio"]
        or entry["analyze_peak_memory_gib"] > entry["wanted_memory_gib"]
    ]
    for name in missed:
        print(f"missed: {name}", file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
