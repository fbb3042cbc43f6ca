# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Whether two versions of the package compute the same numbers, bit for bit: 1.7 min each.

In one version, python -m benchmarks.same before.json writes them; in the other, the same command compares.
"""

import argparse
import hashlib
import json
import subprocess
import sys
from pathlib import Path

from valve_control.control.laws.registry import LAWS

RESEARCH = ("theorems", "calibration")  # commands that are not installed
CONFIG = Path(__file__).resolve().parents[1] / "config"
VALVE = ("--params-file", str(CONFIG / "d3fxe.yaml"))


def commands(bags: list[str]) -> dict[str, tuple[str, ...]]:
    """Commands whose whole JSON output is compared, by a name of each."""
    made: dict[str, tuple[str, ...]] = {}
    for law in LAWS:
        made[f"simulate {law}"] = ("simulate", "--controller", law, *VALVE)
        sine = ("--scenario", "sine", "--set", "frequency=3.0", "--set", "lvdt.delay=0.0013", "--seed", "7")
        made[f"simulate {law} sine"] = ("simulate", "--controller", law, *VALVE, *sine)
        made[f"study {law}"] = ("study", "--controller", law, "--valves", "64", "--folder", "FOLDER")
    for law in ("arc", "oarc"):
        quadratic = ("--set", f"{law}.robust_term=quadratic")
        made[f"simulate {law} quadratic"] = ("simulate", "--controller", law, *VALVE, *quadratic)
    made["compare"] = ("compare", *VALVE)
    made["identify"] = ("identify", *VALVE)
    few = ("--adaptive-valves", "4", "--loop-valves", "50", "--learning-valves", "2")
    made["theorems"] = ("theorems", "--valves", "200", *few)
    made["calibration"] = ("calibration", "--evaluations", "300")
    for bag in bags:
        made[f"shadow {Path(bag).name}"] = ("replay", bag)
    return made


def without_times(value: object) -> object:
    """``value`` without what a clock or a folder put there."""
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if k not in ("seconds", "folder", "version")}
    return [without_times(v) for v in value] if isinstance(value, list) else value


def main() -> int:
    """Write or compare; 1 if something differs."""
    parser = argparse.ArgumentParser(prog="benchmarks.same", description=__doc__)
    parser.add_argument("file", type=Path, help="with the numbers: written if missing, else compared")
    parser.add_argument("bags", nargs="*", default=[], help="bags of which the shadow replay is compared too")
    options = parser.parse_args()
    path, bags = options.file, options.bags
    before = json.loads(path.read_text()) if path.exists() else None
    found: dict[str, str] = {}
    for name, arguments in commands(bags).items():
        folder = path.with_name(f"{path.stem}_{hashlib.sha256(name.encode()).hexdigest()[:8]}_{len(found)}")
        filled = [str(folder) if a == "FOLDER" else a for a in arguments]
        module = (
            [f"research.{arguments[0]}"] if arguments[0] in RESEARCH else ["valve_control.cli", arguments[0]]
        )
        run = [sys.executable, "-m", *module, *filled[1:], "--json", "-"]
        done = subprocess.run(run, capture_output=True, text=True, check=False)
        if not done.stdout:
            print(f"{name} ended with status {done.returncode}: {done.stderr[-300:]}", file=sys.stderr)
            return 1
        found[name] = json.dumps(without_times(json.loads(done.stdout)), sort_keys=True)
        if folder.exists():
            subprocess.run(["rm", "-r", str(folder)], check=True)
        same = "" if before is None else ("same" if before.get(name) == found[name] else "DIFFERS")
        print(f"{name:28} {hashlib.sha256(found[name].encode()).hexdigest()[:12]} {same}", flush=True)
    if before is None:
        path.write_text(json.dumps(found, indent=1) + "\n")
        print(f"wrote {path}")
        return 0
    return 0 if before == found else 1


if __name__ == "__main__":
    sys.exit(main())
