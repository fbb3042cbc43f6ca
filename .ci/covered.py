# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures which lines and branches the tests of the safety core run, node processes included.

Prints each file of the core and the history, and adds this measurement to .ci/coverage.json. The exit
status is 1 if a test failed, or if a file of the core has less than 95 % of its branches and no reason in
.ci/uncovered.json. The compiled twins of numba are not measured: supervisors and nodes run the same functions
in plain Python. With the names of parts only these run, beside what was measured before; ``report`` ends it,
and stores the measurement if all parts passed with the present sources.
"""

import hashlib
import json
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
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
    *(f"valve_control/control/{room}/*.py" for room in ("supervision", "laws", "drivers")),
    *("valve_control/axis/axis_supervisor.py", "valve_control/axis/axis_watch.py"),
    *("valve_control/nodes/controller*.py", "valve_control/nodes/device_controller.py"),
    *(f"valve_control/nodes/{name}.py" for name in ("adapter", "lifecycle", "loop", "services")),
    *(f"valve_control/nodes/{name}.py" for name in ("device_node", "lockstep", "right_of_way", "telemetry")),
    *(f"valve_control/nodes/{name}.py" for name in ("rclpy_internals", "realtime", "timing", "transport")),
    *("valve_control/nodes/valve_driver.py", "valve_control/parameter.py"),
)
CONTROLLER = (
    *(
        "adapter",
        "cascade",
        "controller_node",
        "intruders",
        "lifecycle",
        "lockstep",
        "overload",
        "realtime",
        "reception",
        "refused_starts",
    ),
    *("restart", "timing", "trajectory", "unnumbered"),
)
DEVICES = (
    *("axis", "device_controller", "exit", "fieldbus", "rclpy_internals", "services", "transport"),
    "valve_driver",
)
# Statistics over many valves take minutes and run nothing that other tests do not.
LONG = "study_s_box or beyond_the_spread or weights_were_made_for or jitter_is_the_speed or drifts_by_3"
PATIENT = ("--dist", "loadgroup", "--reruns", "1")  # as make test does with nodes


def tests(room: str, letters: str) -> list[str]:
    """Files of ``room`` whose names begin with ``letters`` (a range), without what takes long."""
    files = sorted((ROOT / "test" / room).glob(f"test_[{letters}]*.py"))
    return [*(str(path.relative_to(ROOT)) for path in files), "-k", f"not ({LONG})"]


PARTS = {
    "conditions": ["test/axis/test_axis_supervisor.py", *tests("supervision", "a-m")],
    "supervisor": tests("supervision", "n-z"),
    "laws": [
        "test/tuning/test_search.py::test_all_that_may_be_chosen_can_be_built",
        "test/tuning/test_search.py::test_a_range_goes_with_speed_and_gain_of_the_valve",
        "test/commissioning/test_solenoid_fit.py::test_the_pid_of_internal_model_control_keeps_the_margins_on_a_box_of_valves",
        "test/commissioning/test_solenoid_fit.py::test_some_designs_keep_the_margins_on_a_box_of_valves[C]",
        *tests("laws", "a-c"),
    ],
    "dcarc": [
        "test/plant/test_transfer_functions.py",
        "test/plant/test_solenoid.py",
        "test/export/test_watched.py::test_the_inverse_of_a_curve_behind_a_law",
        *tests("laws", "d-z"),
    ],
    "drivers": [
        "test/drivers",
        "test/test_plugins.py",
        "test/test_arguments.py",
        "test/test_parameter.py",
        "test/recordings/test_shadow_replay.py",
    ],
    "controller": [*(f"test/nodes/test_{name}.py" for name in CONTROLLER), *PATIENT],
    "devices": [*(f"test/nodes/test_{name}.py" for name in DEVICES), *PATIENT],
}


def coverage(*words: str) -> int:
    """Run coverage; returns its exit status."""
    return subprocess.run([sys.executable, "-m", "coverage", *words], cwd=ROOT, check=False).returncode


def measured(part: str) -> int:
    """Run the tests of ``part`` under coverage, and mark it if they pass; returns their exit status."""
    mark = DATA / f"{part}.passed"
    mark.unlink(missing_ok=True)
    before = sources()
    chosen = ["-m", "not campaign and not browser and not alone", *PARTS[part]]
    status = coverage("run", "-m", "pytest", "-q", "-n", "2", *chosen)
    if status == 0:
        mark.write_text(before, encoding="utf-8")
    return status


def passed(part: str) -> bool:
    """Whether the tests of ``part`` passed with the present sources; in others lines have other numbers."""
    mark = DATA / f"{part}.passed"
    return mark.exists() and mark.read_text(encoding="utf-8") == sources()


def sources() -> str:
    """Digest of the package's sources."""
    paths = sorted((ROOT / "valve_control").rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def share(summaries: Iterable[dict[str, int]], what: str, whole: str) -> float:
    """Percentage of ``whole`` that was run; 100 of nothing."""
    summaries = list(summaries)
    number = sum(one[whole] for one in summaries)
    return 100.0 * sum(one[what] for one in summaries) / number if number else 100.0


def lines_of(*summaries: dict[str, int]) -> float:
    """Percentage of the lines."""
    return share(summaries, "covered_lines", "num_statements")


def branches_of(*summaries: dict[str, int]) -> float:
    """Percentage of the branches."""
    return share(summaries, "covered_branches", "num_branches")


def missing(file: dict[str, Any]) -> str:
    """Lines and branches that no test ran."""
    lines = set(file["missing_lines"])
    branches = [
        f"{a}→{'end' if b < 0 else b}" for a, b in file["missing_branches"] if not lines & {abs(a), abs(b)}
    ]
    return ", ".join([*map(str, sorted(lines)), *branches])


def table(core: dict[str, Any], reasons: dict[str, str]) -> list[str]:
    """Lines of the table of files."""
    lines = [f"{'':52}{'lines %':>9}{'branches %':>12}  not run (line, or line→line)"]
    for name, file in core.items():
        one = file["summary"]
        figures = f"{lines_of(one):9.1f}{branches_of(one):12.1f}"
        lines.append(f"{name.removeprefix('valve_control/'):52}{figures}  {missing(file)}".rstrip())
        if name in reasons:
            lines.append(f"{'':52}  because {reasons[name]}")
    return lines


def entry(core: dict[str, Any], files: dict[str, Any]) -> dict[str, Any]:
    """Entry of the history; ``below``: files of the core with too few branches."""
    inner, all_files = ([file["summary"] for file in some.values()] for some in (core, files))
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "version": ElementTree.parse(ROOT / "package.xml").findtext("version", ""),
        "core": {"lines": round(lines_of(*inner), 2), "branches": round(branches_of(*inner), 2)},
        "package": {"lines": round(lines_of(*all_files), 2), "branches": round(branches_of(*all_files), 2)},
        "below": [name for name, file in core.items() if branches_of(file["summary"]) < LEAST],
    }


def report(store: bool) -> int:
    """Print what was measured, ``store``: into the history too; returns the exit status."""
    if coverage("combine", "-q", "--append") > 1 or coverage(
        "json", "-q", "-i", "-o", str(DATA / "coverage.json")
    ):
        return 1
    files = json.loads((DATA / "coverage.json").read_text(encoding="utf-8"))["files"]
    names = [str(path.relative_to(ROOT)) for pattern in CORE for path in sorted(ROOT.glob(pattern))]
    core = {name: files[name] for name in names}
    reasons = json.loads(REASONS.read_text(encoding="utf-8"))
    new = entry(core, files)
    history = json.loads(HISTORY.read_text(encoding="utf-8")) if HISTORY.exists() else []
    history = [old for old in history if (old["date"], old["version"]) != (new["date"], new["version"])] + [
        new
    ]
    print("\n".join(table(core, reasons)))
    print(f"\n{'':20}{'safety core':^24}{'whole package, these tests':^28}\n{'':20}", end="")
    print(f"{'lines %':>10}{'branches %':>12}{'lines %':>12}{'branches %':>12}{'below':>8} {LEAST:g} %")
    for old in history[-SHOWN:]:
        figures = [old[part][kind] for part in ("core", "package") for kind in ("lines", "branches")]
        shown = "".join(
            f"{figure:{width}.2f}" for figure, width in zip(figures, (10, 12, 12, 12), strict=True)
        )
        print(f"{old['date']:12}{old['version']:8}{shown}{len(old['below']):8}")
    wrong = [name for name in new["below"] if name not in reasons]
    for name in wrong:
        print(
            f"{name} has less than {LEAST:g} % of its branches and no reason in {REASONS.relative_to(ROOT)}"
        )
    if store:
        rows = ",\n".join(json.dumps(old) for old in history)
        HISTORY.write_text(f"[\n{rows}\n]\n", encoding="utf-8")
    return 1 if wrong else 0


def main(words: list[str]) -> int:
    """Measure all parts, or those named in ``words``; returns the exit status."""
    unknown = [word for word in words if word != "report" and word not in PARTS]
    if unknown:
        print(f"covered.py: no part {unknown[0]!r}; there are {', '.join(PARTS)} and report", file=sys.stderr)
        return 2
    if not words:
        shutil.rmtree(DATA, ignore_errors=True)
    DATA.mkdir(parents=True, exist_ok=True)
    failed = [part for part in words or PARTS if part != "report" and measured(part)]
    if words and "report" not in words:
        return 1 if failed else 0
    missing_parts = [part for part in PARTS if not passed(part)]
    if missing_parts:
        print(
            f"not stored: {', '.join(missing_parts)} did not pass with the present sources", file=sys.stderr
        )
    return report(store=not missing_parts) or (1 if failed else 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
