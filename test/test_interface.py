# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The public interface stays: names that users, launch files, bags and scripts hold on to.

``python test/test_interface.py`` writes interface.json anew. A name that goes needs a new major version, see
QUALITY_DECLARATION.md.
"""

import importlib.util
import json
import re
from pathlib import Path

import valve_control
from valve_control.axis.tables import ROS_NODES

ROOT = Path(__file__).resolve().parents[1]
RECORD = Path(__file__).with_name("interface.json")


def _generate():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _options(parser):
    return sorted(option for action in parser._actions for option in action.option_strings)


def _conditions():
    """Names in the first column of the table in docs/reference/modes.md."""
    table = (ROOT / "docs" / "reference" / "modes.md").read_text(encoding="utf-8").split("| condition |")[1]
    cells = (row.split(" | ")[0] for row in table.split("\n\n")[0].splitlines() if row.startswith("| `"))
    return sorted({name for cell in cells for name in re.findall(r"`(\w+)`", cell)})


def interface():
    """Parameters with types, topics and services, conditions, command line, Python, entry point groups."""
    from valve_control.cli import command
    from valve_control.control.drivers import registry as drivers
    from valve_control.control.laws import registry as laws
    from valve_control.control.plant import registry as plants

    return {
        "parameters": {node: {p.name: p.type_name for p in table} for node, table in ROS_NODES.items()},
        "topics and services": sorted(
            f"{e.node} {e.kind} {e.name} {e.type_name}" for e in _generate().entities()
        ),
        "conditions": _conditions(),
        "command line": {name: _options(p) for name, p in command.Commands().parsers.items()},
        "Python": sorted(valve_control.__all__),
        "entry point groups": [laws.GROUP, plants.GROUP, drivers.GROUP],
    }


def _lost(before, now, path=""):
    if isinstance(before, dict):
        for name, value in before.items():
            if not isinstance(now, dict) or name not in now:
                yield f"{path}/{name}"
            else:
                yield from _lost(value, now[name], f"{path}/{name}")
    elif isinstance(before, list):
        yield from (f"{path}/{item}" for item in before if item not in now)
    elif before != now:
        yield f"{path}: {before} became {now}"


def test_no_public_name_is_lost():
    assert list(_lost(json.loads(RECORD.read_text(encoding="utf-8")), interface())) == []


if __name__ == "__main__":
    RECORD.write_text(json.dumps(interface(), indent=1) + "\n", encoding="utf-8")
    print(f"wrote {RECORD}")
