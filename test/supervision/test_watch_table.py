# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The table of watches is complete, the docs show it, and a new watch is one file and one row.

``python test/supervision/test_watch_table.py`` writes the table into docs/reference/modes.md.
"""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from valve_control.control.supervision import watch_table
from valve_control.control.supervision.journal import OBSERVED

ROOT = Path(__file__).resolve().parents[2]
SUPERVISION = ROOT / "valve_control" / "control" / "supervision"
MODES = ROOT / "docs" / "reference" / "modes.md"
HEAD = "| condition | diagnostic | mode | meaning | action |\n|---|---|---|---|---|\n"


def rows():
    """The table as it stands in docs/reference/modes.md."""
    for one in watch_table.conditions():
        names = ", ".join(f"`{name}`" for name in one.names)
        yield f"| {names} | {one.sentence} | {one.mode} | {one.meaning} | {one.action} |\n"


def reported():
    """Names that the supervisor gives conditions in its source."""
    for path in sorted(SUPERVISION.glob("*.py")):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and len(call.args) >= 3:
                name = getattr(call.func, "attr", getattr(call.func, "id", ""))
                if name in ("report", "latch") and isinstance(call.args[1], ast.Constant):
                    yield str(call.args[1].value)


def test_docs_show_the_table():
    assert HEAD + "".join(rows()) in MODES.read_text(encoding="utf-8"), f"run python {__file__}"


def test_the_table_has_each_condition_that_is_reported():
    listed = {name for one in watch_table.conditions() for name in one.names}
    assert set(reported()) | {name for _, name in OBSERVED.values()} <= listed
    sources = "".join(path.read_text(encoding="utf-8") for path in SUPERVISION.glob("*.py"))
    text = re.sub(r"CONDITIONS = \(\n.*?\n\)\n|OF_NODES = \(\n.*?\n\)", "", sources, flags=re.DOTALL)
    own = {watch.condition for watch in watch_table.REPORTING}
    for name in listed - own:
        known = f'"{name}"' in text or f'"{name.removesuffix("_bridged")}"' in text
        assert known, f"{name} is in the table, and nothing reports it"


NEW = '''
"""Watches for readings beyond a limit, as a test."""

from typing import NamedTuple

from valve_control.control.supervision import plausibility
from valve_control.control.supervision.conditions import ReportedCondition
from valve_control.parameter import Values, number

CONDITIONS = (
    ReportedCondition(
        ("lvdt_far",), "degraded", "LVDT is far out at … V", "readings beyond half of lvdt.limit", "look"
    ),
)


class Params(NamedTuple):
    """What is allowed."""

    limit: float  # V


class State(NamedTuple):
    """Blocks in a row beyond it."""

    blocks: float
    last: float  # V


NOTHING = State(0.0, 0.0)


def design(values: Values, c: plausibility.Params) -> Params:
    """Params."""
    return Params(0.25 * number(values, "lvdt.limit"))


def step(p: Params, s: State, seen: plausibility.SeenBlock) -> State:
    """State after one more block."""
    return State(s.blocks + 1.0 if abs(seen.shown.y1) > p.limit else 0.0, seen.shown.y1)


def found(p: Params, s: State) -> bool:
    """Whether there are five of them."""
    return s.blocks >= 5.0


def text(p: Params, s: State) -> str:
    """One sentence."""
    return f"LVDT is far out at {s.last:.2g} V"

'''
RUN = """
import json
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision import watch_table
from valve_control.control.supervision.state_snapshot import restore, snapshot
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated

values = updated(CONTROLLER, defaults(CONTROLLER), {"controller": "pid"})
one = Supervisor()
one.apply(values, build.law_params(values))
p = build.valve_params(defaults(VALVE))
s, said, modes = valve.initial(p), set(), set()
for k in range(1500):
    one.command(3.5 if k > 200 else 0.0)
    s = valve.step(p, s, one.sample(valve.read(p, s, 0.0), k + 1))
    if "lvdt_far" in one.conditions:
        said.add(one.conditions["lvdt_far"]); modes.add(one.mode.name)
other = Supervisor()
other.apply(values, build.law_params(values))
assert restore(other, snapshot(one)) and other.memory.far == one.memory.far
print(json.dumps([sorted(said), sorted(modes), "lvdt_far" in str(watch_table.conditions()),
                  json.loads(snapshot(one))["state"]["far"]]))
"""


def test_a_new_watch_is_one_file_and_one_row(tmp_path):
    """In a copy of the package: its sentence, its mode, and its state in a snapshot."""
    package = tmp_path / "valve_control"
    shutil.copytree(ROOT / "valve_control", package, ignore=shutil.ignore_patterns("*.pyc.*"))
    rooms = package / "control" / "supervision"
    (rooms / "far_watch.py").write_text(NEW, encoding="utf-8")
    table = rooms / "watch_table.py"
    text = table.read_text(encoding="utf-8")
    text = text.replace("    gain_watch,\n", "    far_watch,\n    gain_watch,\n")
    row = 'REPORTING = (\n    Watch(far_watch, "far"),\n'
    table.write_text(text.replace("REPORTING = (\n", row), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    said, modes, listed, state = json.loads(done.stdout)
    assert listed and modes == ["DEGRADED"] and len(state) == 2
    assert said and all(re.fullmatch(r"LVDT is far out at [\d.]+ V", sentence) for sentence in said)


def main():
    """Write the table into docs/reference/modes.md."""
    text = MODES.read_text(encoding="utf-8")
    made = re.sub(
        r"\| (condition \| )?diagnostic \|.*?\n(?=\n)",
        lambda _: HEAD + "".join(rows()),
        text,
        count=1,
        flags=re.DOTALL,
    )
    MODES.write_text(made, encoding="utf-8")


if __name__ == "__main__":
    main()
