# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks the items of REP-2004, level 2, that QUALITY_DECLARATION.md declares.

The exit status is 1 if an item that is declared met is not, or one declared open is met. With ``--quiet``
only these are printed. With ``--add`` it puts the two SPDX lines into source files that have none.
"""

import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMENTS = {".py": "# {}\n", ".js": "// {}\n", ".c": "/* {} */\n", ".h": "/* {} */\n", ".css": "/* {} */\n"}
LINES = ("SPDX-FileCopyrightText: 2026 valve_control developers", "SPDX-License-Identifier: Apache-2.0")
ROW = re.compile(r"^\| (\d\.[ivabc.]+) \| (.+?) \| (met|open) \| (.+) \|$", re.M)


def text(name: str) -> str:
    """Contents of the file ``name`` of the repository, "" if there is none."""
    path = ROOT / name
    return path.read_text(encoding="utf-8") if path.exists() else ""


def sources() -> Iterator[Path]:
    """Source files under version control."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        path = ROOT / name
        if path.suffix in COMMENTS and path.is_file() and path.stat().st_size:
            yield path


def unmarked() -> list[Path]:
    """Source files without the SPDX lines in their first five lines."""
    heads = ((path, path.read_text(encoding="utf-8").splitlines()[:5]) for path in sources())
    return [path for path, head in heads if not all(any(line in row for row in head) for line in LINES)]


def add() -> None:
    """Put the SPDX lines into the files that have none."""
    for path in unmarked():
        before = path.read_text(encoding="utf-8")
        first, _, rest = before.partition("\n") if before.startswith("#!") else ("", "", before)
        lines = "".join(COMMENTS[path.suffix].format(line) for line in LINES)
        path.write_text(f"{first}\n{lines}{rest}" if first else lines + rest, encoding="utf-8")
        print(f"wrote {path.relative_to(ROOT)}")


def version() -> str:
    """Version in package.xml."""
    return ElementTree.parse(ROOT / "package.xml").findtext("version", "")


def section(title: str) -> bool:
    """Whether the declaration has the section ``title``."""
    return f"\n## {title}\n" in text("QUALITY_DECLARATION.md")


def licences() -> bool:
    """Whether LICENSE, package.xml and setup.py agree."""
    return (
        "Apache License" in text("LICENSE")
        and "<license>Apache-2.0</license>" in text("package.xml")
        and 'license="Apache-2.0"' in text("setup.py")
    )


def runs(*words: str) -> bool:
    """Whether .ci/run and the target ``lint`` run all of ``words``."""
    return all(word in text(".ci/run") + text("Makefile") for word in words)


def justified() -> bool:
    """Whether the table of dependencies has every package that setup.py installs, or installs on request."""
    setup = text("setup.py")
    needed = re.search(r"install_requires=\[(.*?)\]", setup, re.S)
    extras = re.search(r"extras_require=\{(.*?)\"test\":", setup, re.S)
    if needed is None or extras is None:
        return False
    names = set(
        re.findall(r'"([A-Za-z0-9_-]+)[>=<"]', needed.group(1) + re.sub(r'"\w+":', "", extras.group(1)))
    )
    table = text("QUALITY_DECLARATION.md").partition("## Dependencies")[2]
    return all(name in table for name in names - {"setuptools"})


def policy(*words: str) -> bool:
    """Whether the version policy speaks of all ``words``."""
    part = text("QUALITY_DECLARATION.md").partition("\n## Version policy\n")[2].partition("\n## ")[0]
    return all(word in part for word in words)


def covered() -> bool:
    """Whether this version's coverage was measured, and each file below 95 % of branches has a reason."""
    history = json.loads(text(".ci/coverage.json") or "[]")
    reasons = json.loads(text(".ci/uncovered.json") or "{}")
    return (
        ".ci/covered.py" in text("Makefile")
        and bool(history)
        and history[-1]["version"] == version()
        and all(reasons.get(name) for name in history[-1]["below"])
    )


def reachable() -> bool:
    """Whether the policy has a schedule, and the maintainer an address that can receive mail."""
    maintainer = ElementTree.parse(ROOT / "package.xml").find("maintainer")
    address = "" if maintainer is None else maintainer.get("email", "")
    return all(word in text("SECURITY.md") for word in ("REP-2006", "days")) and not re.search(
        r"example\.(com|org|net)$", address
    )


CHECKS: dict[str, Callable[[], bool]] = {
    "1.i": lambda: policy("Semantic Versioning"),
    "1.ii": lambda: int(version().split(".")[0]) >= 1,
    "1.iii": lambda: section("Public interface") and bool(text("test/interface.json")),
    "1.iv": lambda: policy("deprecate", "major version"),
    "1.v": lambda: policy("ABI"),
    "1.vi": lambda: policy("distribution"),
    "2.iv": lambda: runs("make lint", "make test", "make campaign") and ".ci/run" in text("CONTRIBUTING.md"),
    "3.iii": licences,
    "3.iv": lambda: not unmarked(),
    "3.v.a": lambda: "QUALITY_DECLARATION.md" in text("README.md"),
    "4.i": lambda: all(text(f"test/{name}.py") for name in ("test_docs", "nodes/test_cascade")),
    "4.iii.a": covered,
    "4.v.a": lambda: runs("ruff check", "ruff format --check"),
    "4.v.b": lambda: runs("mypy", "lint-imports"),
    "5.iii": justified,
    "7.i": reachable,
}
# The chart of REP-2004 asks these of Level 2; what has no check is declared by people.
ITEMS = {
    *CHECKS,
    *("2.i", "2.ii", "3.i", "3.v", "3.v.c", "5.i", "6.i"),
}


def main(quiet: bool) -> int:
    """Print one line for each item of the declaration, ``quiet``: the wrong ones; returns the exit status."""
    rows = ROW.findall(text("QUALITY_DECLARATION.md"))
    wrong = 0
    for item, requirement, state, evidence in rows:
        checked = CHECKS.get(item)
        found = "declared" if checked is None else "checked"
        if checked is not None and checked() != (state == "met"):
            found, wrong = "WRONG", wrong + 1
        if found == "WRONG" or not quiet:
            print(f"{item:<7}  {state:<4}  {found:<8}  {requirement}: {evidence}")
    listed = {row[0] for row in rows}
    if listed != ITEMS:
        print(f"QUALITY_DECLARATION.md lacks or has too much: {', '.join(sorted(listed ^ ITEMS))}")
    for path in unmarked():
        print(f"{path.relative_to(ROOT)} has no SPDX lines (python .ci/quality.py --add)")
    return 1 if wrong or listed != ITEMS or unmarked() else 0


if __name__ == "__main__":
    if "--add" in sys.argv[1:]:
        add()
    sys.exit(main("--quiet" in sys.argv[1:]))
