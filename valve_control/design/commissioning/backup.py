# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps the parameters from before a commissioning, and its whole tests, in files.

So the parameters come back whatever happens, and another commissioning can go on after the tests.
"""

import io
import itertools
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control import outputs
from valve_control.control.parameters import arguments, files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.commissioning.bench import Record, SafetyLimits
from valve_control.parameter import ParameterError, Value, Values

PARAMETERS = "before.yaml"
STATE = "state.json"
TESTS = "tests.npz"
EARLIER = "earlier"  # folder of what earlier commissionings left
RUNNING, DONE, ABORTED, UNDONE = "running", "commissioned", "aborted", "undone"


class Backup(NamedTuple):
    """The parameters of one controller from before, and how its commissioning stands."""

    node: str  # full name
    values: Values
    state: str


def write(folder: Path, node: str, values: Values) -> None:
    """Write the parameters of ``node``, and that its commissioning runs. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    text = files.as_yaml(
        {node: values}, ["Parameters from before the commissioning; --undo brings them back."]
    )
    outputs.write(str(folder / PARAMETERS), text)
    mark(folder, node, RUNNING)


def set_aside(folder: Path, results: Sequence[str]) -> Path | None:
    """Move parameters, state and ``results`` of an earlier commissioning to a folder of their own.

    Returns that folder, which ``read`` takes as well; None: nothing was left. Raises OSError.
    """
    left = [path for name in (*results, STATE, PARAMETERS) if (path := folder / name).exists()]
    if not left:
        return None
    places = (folder / EARLIER / str(number) for number in itertools.count(1))
    place = next(path for path in places if not path.exists())
    place.mkdir(parents=True)
    for path in left:
        path.rename(place / path.name)
    return place


def mark(folder: Path, node: str, state: str) -> None:
    """Write how the commissioning of ``node`` stands. Raises OSError."""
    outputs.write(str(folder / STATE), outputs.as_json({"node": node, "state": state}))


def read(folder: Path) -> Backup | None:
    """What ``folder`` has, None if it has nothing. Raises ParameterError for files that are damaged."""
    path = folder / STATE
    if not path.exists():
        return None
    try:
        told: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        node, state = str(told["node"]), str(told["state"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ParameterError(f"{path} is damaged: {error}") from error
    values = arguments.addressed(str(folder / PARAMETERS), node, CONTROLLER)
    return Backup(node, values, state)


def write_tests(folder: Path, node: str, limits: SafetyLimits, records: Mapping[str, Record]) -> None:
    """Write the whole tests of ``node`` that were made within ``limits``. Raises OSError."""
    arrays = {f"{name}.{field}": v for name, record in records.items() for field, v in _fields(record)}
    packed = io.BytesIO()
    np.savez_compressed(packed, node=np.array(node), limits=np.array(limits), **arrays)
    outputs.write(str(folder / TESTS), packed.getvalue())


def read_tests(folder: Path, node: str, limits: SafetyLimits, period: float) -> dict[str, Record]:
    """Whole tests by name. Raises ParameterError unless they are of ``node`` with these limits and period."""
    path = folder / TESTS
    if not path.exists():
        raise ParameterError(f"{folder} has no whole test of a commissioning; --resume names another folder")
    try:
        with np.load(path) as kept:
            told = str(kept["node"]), SafetyLimits(*map(float, kept["limits"]))
            names = {name.rpartition(".")[0] for name in kept.files} - {""}
            records = {name: _record(kept, name) for name in names}
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise ParameterError(f"{path} is damaged: {error}") from error
    if told != (node, limits) or any(record.period != period for record in records.values()):
        raise ParameterError(
            f"the tests in {folder} are of {told[0]} within ±{told[1].voltage:g} V and ±{told[1].travel:g} V "
            f"of travel; --resume needs the same node, --max-voltage, --travel and sample_period"
        )
    return records


def _record(kept: Mapping[str, Any], name: str) -> Record:
    reading, voltage, command, begins, latency = (
        kept[f"{name}.{field}"] for field in ("reading", "voltage", "command", "begins", "latency")
    )
    return Record(float(kept[f"{name}.period"]), reading, voltage, command, tuple(map(int, begins)), latency)


def _fields(record: Record) -> list[tuple[str, Any]]:
    return [(name, np.asarray(value)) for name, value in record._asdict().items()]


def differences(present: Values, wanted: Values) -> dict[str, Value]:
    """What has to be set so that ``present`` becomes ``wanted``."""
    return {name: value for name, value in wanted.items() if present.get(name) != value}
