# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""docs/reference/modes.md has a row of each condition that the supervisor reports, and no other."""

import ast
import re
from pathlib import Path

from valve_control.control.supervision import cycle_watch, lvdt, watch_table
from valve_control.control.supervision.journal import OBSERVED

ROOT = Path(__file__).resolve().parents[2]
SUPERVISION = ROOT / "valve_control" / "control" / "supervision"
MODES = ROOT / "docs" / "reference" / "modes.md"
READINGS = ("lvdt_not_finite", "lvdt_out_of_range", "lvdt_jump", "lvdt_frozen")


def described():
    """Names in the first column of the table of conditions."""
    table = MODES.read_text(encoding="utf-8").split("| condition |")[1].split("\n\n")[0]
    cells = (row.split(" | ")[0] for row in table.splitlines() if row.startswith("| `"))
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


def reported():
    """Names that the supervisor gives conditions."""
    for path in sorted(SUPERVISION.glob("*.py")):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and len(call.args) >= 3:
                name = getattr(call.func, "attr", getattr(call.func, "id", ""))
                if name in ("report", "latch") and isinstance(call.args[1], ast.Constant):
                    yield str(call.args[1].value)
    for fault in READINGS:
        assert fault in lvdt.TEXTS
        yield from (fault, f"{fault}_bridged")
    yield from (cycle_watch.HUM, cycle_watch.LIMIT_CYCLE, "stalled")
    yield from (one.condition for one in watch_table.REPORTING)
    yield from (name for _, name in OBSERVED.values())


def test_docs_describe_each_condition_that_is_reported():
    assert described() == set(reported())
