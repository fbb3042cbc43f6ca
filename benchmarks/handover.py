# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the exported C costs: ns a step, bytes of state, parameters and code of each law and plant."""

import re
import subprocess
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.batch import BenchmarkError
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import files, ros_file
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.export import folder, unit
from valve_control.export.unit import Unit
from valve_control.parameter import Values, defaults, updated

WANTED: dict[str, tuple[str, float]] = {}
SAID = re.compile(r"(?:to the last bit|within (\S+) V); (\d+) ns a step, state (\d+) bytes, parameters (\d+)")


def values(name: str) -> Values:
    """Default values of the controller with the law ``name``."""
    return updated(CONTROLLER, defaults(CONTROLLER), {"controller": name})


def units() -> dict[str, tuple[Unit, bool]]:
    """What is measured, by the name of its row: the unit, and whether in float."""
    valve_values = updated(
        VALVE, defaults(VALVE), files.load(str(ros_file.config_folder() / "d3fxe.yaml"))["valve_simulator"]
    )
    made = {name: (unit.law(values(name)), False) for name in LAWS}
    made |= {f"{name} --watch": (unit.supervised(values(name)), False) for name in LAWS}
    made |= {f"{name} --float": (unit.law(values(name)), True) for name in LAWS}
    made["valve"] = unit.plant(valve_values), False
    return made


def measured(chosen: Unit, single: bool, place: Path) -> dict[str, float]:
    """Cost of ``chosen``, exported to the new folder ``place``. Raises BenchmarkError."""
    folder.write(place, folder.files(chosen, single))
    command = ["make", "-C", str(place), "check", "size", "CC=gcc"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = SAID.search(done.stdout)
    if done.returncode or found is None:
        raise BenchmarkError(f"{chosen.name}: {(done.stderr or done.stdout).strip().splitlines()[-1]}")
    code = done.stdout.splitlines()[-2].split()[0]
    cost = dict(zip(("ns", "state", "parameters"), map(float, found.groups()[1:]), strict=True))
    return {**cost, "code": float(code), **({"difference": float(found.group(1))} if single else {})}


def run(work: Path) -> dict[str, Any]:
    """Rows of the table in docs/howto/export.md, printed too. Raises BenchmarkError."""
    rows = {}
    for name, (chosen, single) in tqdm(units().items(), unit="export"):
        rows[name] = measured(chosen, single, work / name.replace(" ", ""))
    print("| what | ns a step | state [bytes] | parameters [bytes] | code [bytes] | float is off by [mV] |")
    print("|---|---|---|---|---|---|")
    for name, row in rows.items():
        off = f"{1e3 * row['difference']:.2g}" if "difference" in row else ""
        cells = (f"{row[key]:.0f}" for key in ("ns", "state", "parameters", "code"))
        print(f"| `{name}` | {' | '.join(cells)} | {off} |")
    return {"figures": {}, "rows": rows}
