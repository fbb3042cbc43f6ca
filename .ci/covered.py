# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures lines and branches of the safety core that its tests run, node processes included.

Prints each file, with the history that .ci/coverage.json keeps, and adds this measurement to it. The exit
status is 1 if a test failed, or if a file of the core has less than 95 % of its branches and no reason in
.ci/uncovered.json. Compiled functions are measured where a node or a supervisor runs them in plain Python.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "out" / "coverage"
HISTORY = ROOT / ".ci" / "coverage.json"
REASONS = ROOT / ".ci" / "uncovered.json"
LEAST = 95.0  # % of the branches of each file
SHOWN = 10  # measurements of the history
# What computes, judges and sends the voltage: supervision, laws and drivers, and the node around them.
CORE = (
    "valve_control/control/supervision/*.py",
    "valve_control/control/laws/*.py",
    "valve_control/control/drivers/*.py",
    *(
        f"valve_control/nodes/{name}.py"
        for name in (
            *(
                "adapter",
                "controller",
                "device_controller",
                "lifecycle",
                "loop",
                "pairing",
                "rclpy_internals",
            ),
            *("realtime", "services", "transport", "valve_driver"),
        )
    ),
    "valve_control/parameter.py",
)
ALL = "not campaign and not browser and not alone"
# Long statistics over many valves run nothing that others do not.
LONG = "not study_s_box and not beyond_the_spread and not weights_were_made_for and not jitter_is_the_speed"
CORE_TESTS = (
    "test/supervision",
    "test/laws",
    "test/drivers",
    "test/test_plugins.py",
    "test/test_arguments.py",
)
NODE_TESTS = tuple(
    f"test/nodes/test_{name}.py"
    for name in (
        *("adapter", "device_controller", "disagreement", "exit", "fieldbus", "lifecycle", "pairing"),
        *("rclpy_internals", "reception", "restart", "services", "trajectory", "transport", "unnumbered"),
        *("valve_driver", "terms", "axis", "cascade", "lockstep"),
    )
)


def measured(*words: str) -> int:
    """Run pytest under coverage; returns its exit status."""
    command = [sys.executable, "-m", "coverage", "run", "-m", "pytest", "-q", "-n", "2", *words]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


def tool(*words: str) -> None:
    """Run coverage. Raises CalledProcessError."""
    subprocess.run([sys.executable, "-m", "coverage", *words], cwd=ROOT, check=True)


def share(part: int, whole: int) -> float:
    """Percentage; 100 of nothing."""
    return 100.0 * part / whole if whole else 100.0


def core() -> Iterator[str]:
    """Files of the safety core."""
    for pattern in CORE:
        yield from sorted(str(path.relative_to(ROOT)) for path in ROOT.glob(pattern))


def missing(file: dict[str, Any]) -> str:
    """Lines and branches that no test ran."""
    lines = [str(line) for line in file["missing_lines"]]
    branches = [f"{a}→{'end' if b < 0 else b}" for a, b in file["missing_branches"]]
    return ", ".join(lines + branches)


def table(files: dict[str, Any], reasons: dict[str, str]) -> tuple[list[str], list[str]]:
    """Lines of the table, and files that have too little and no reason."""
    lines = [f"{'':56}{'lines %':>9}{'branches %':>12}  not run (line, or line→line)"]
    poor = []
    for name in core():
        if name not in files:
            poor.append(name)
            continue
        one = files[name]["summary"]
        branches = share(one["covered_branches"], one["num_branches"])
        lines.append(
            f"{name:56}{share(one['covered_lines'], one['num_statements']):9.1f}{branches:12.1f}  "
            f"{missing(files[name])}"
        )
        if name in reasons:
            lines.append(f"{'':56}  because {reasons[name]}")
        if branches < LEAST and name not in reasons:
            poor.append(name)
    return lines, poor


def summary(sums: list[dict[str, int]]) -> dict[str, Any]:
    """Entry of the history."""

    def percent(what: str) -> float:
        covered, number = f"covered_{what}", {"lines": "num_statements", "branches": "num_branches"}[what]
        return round(share(sum(one[covered] for one in sums), sum(one[number] for one in sums)), 2)

    date = datetime.now(UTC).strftime("%Y-%m-%d")
    return {"date": date, "files": len(sums), "lines": percent("lines"), "branches": percent("branches")}


def main() -> int:
    """Measure, print, and add to the history; returns the exit status."""
    shutil.rmtree(DATA, ignore_errors=True)
    DATA.mkdir(parents=True)
    failed = measured(*CORE_TESTS, "-m", ALL, "-k", LONG) or measured(
        *NODE_TESTS, "-m", ALL, "--dist", "loadgroup", "--reruns", "2"
    )
    tool("combine", "-q")
    tool("json", "-q", "-i", "-o", str(DATA / "coverage.json"))
    files = json.loads((DATA / "coverage.json").read_text(encoding="utf-8"))["files"]
    reasons = json.loads(REASONS.read_text(encoding="utf-8"))
    lines, poor = table(files, reasons)
    entry = summary([files[name]["summary"] for name in core() if name in files])
    entry["below"] = len(poor) + len(reasons)
    history = json.loads(HISTORY.read_text(encoding="utf-8")) if HISTORY.exists() else []
    history = [old for old in history if old["date"] != entry["date"]] + [entry]
    print("\n".join(lines))
    print(f"\n{'':12}{'files':>8}{'lines %':>10}{'branches %':>12}{'below':>8} {LEAST:g} %")
    for old in history[-SHOWN:]:
        print(f"{old['date']:12}{old['files']:8}{old['lines']:10.2f}{old['branches']:12.2f}{old['below']:8}")
    for name in poor:
        print(
            f"{name} has less than {LEAST:g} % of its branches and no reason in {REASONS.relative_to(ROOT)}"
        )
    if not failed:
        rows = ",\n".join(json.dumps(old) for old in history)
        HISTORY.write_text(f"[\n{rows}\n]\n", encoding="utf-8")
    return 1 if failed or poor else 0


if __name__ == "__main__":
    sys.exit(main())
