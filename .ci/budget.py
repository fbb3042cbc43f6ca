# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compares the lines of each room with its budget in rooms.toml, and prints the table.

The exit status is 1 if a room is over its budget.
"""

import subprocess
import sys
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COUNTED = {".py", ".c", ".h", ".js", ".css", ".html"}


def main() -> int:
    """Print the table; returns the exit status."""
    rooms = tomllib.loads((ROOT / ".ci" / "rooms.toml").read_text(encoding="utf-8"))["room"]
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "valve_control", "test"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    counts = dict.fromkeys(rooms, 0)
    for name in listed:
        path = ROOT / name
        if path.suffix not in COUNTED or not path.is_file():
            continue
        fits = [(len(p), room) for room in rooms for p in rooms[room]["files"] if fnmatchcase(name, p)]
        counts[max(fits)[1]] += len(path.read_bytes().splitlines())
    rest = [room for room in rooms if room != "test"]
    excess = {room: lines - rooms[room]["budget"] for room, lines in counts.items()}
    excess = {room: lines for room, lines in excess.items() if lines > 0}
    print(f"{'room':<42}{'lines':>8}{'budget':>8}{'goal':>8}")
    for room, row in rooms.items():
        over = "  over budget" if room in excess else ""
        print(f"{room:<42}{counts[room]:>8}{row['budget']:>8}{row['goal']:>8}{over}")
    sums = [sum(counts[room] for room in rest), *(sum(rooms[r][k] for r in rest) for k in ("budget", "goal"))]
    print(f"{'package':<42}" + "".join(f"{number:>8}" for number in sums))
    for room, lines in excess.items():
        print(
            f"{room} is {lines} lines over its budget: open the pull request so, the reviewer names "
            "lines that go (CONTRIBUTING.md, Budgets)",
            file=sys.stderr,
        )
    return 1 if excess else 0


if __name__ == "__main__":
    sys.exit(main())
