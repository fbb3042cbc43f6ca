# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads a measured table of indices from a file."""

import csv
import json
import math
from pathlib import Path
from typing import Any

from valve_control import inputs
from valve_control.control.analysis.indices import PAPER_TABLE_1, Indices
from valve_control.control.laws.registry import LAWS
from valve_control.parameter import ParameterError

ROWS = f"one row for each of {', '.join(LAWS)} or some of them"
COLUMNS = f"the columns {', '.join(Indices._fields)}"


def read(path: str) -> dict[str, Indices]:
    """Read a table from a CSV file with a header, or a YAML or JSON file; ``paper`` is the paper's Table 1.

    Rows are controllers; an index that was not measured is left empty (null). Raises ParameterError.
    """
    if path == "paper":
        return dict(PAPER_TABLE_1)
    inputs.check(path, "table")
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(
            f"table {path} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error
    try:
        rows = _from_csv(text) if Path(path).suffix == ".csv" else _from_tree(path, text)
        return _checked(rows)
    except ValueError as error:
        raise ParameterError(f"table {path} {error}") from error


def _from_csv(text: str) -> dict[str, dict[str, Any]]:
    reader = csv.DictReader(line for line in text.splitlines() if line.strip() and line[0] != "#")
    if not reader.fieldnames or reader.fieldnames[0].strip() != "controller":
        raise ValueError(f"must begin with a line of column names, controller and {COLUMNS}")
    names = [name.strip() for name in reader.fieldnames]
    if len(set(names)) < len(names):
        raise ValueError(f"has two columns of one name: {', '.join(names)}")
    rows: dict[str, dict[str, Any]] = {}
    for row in reader:
        cells = {str(key).strip(): value for key, value in row.items()}
        if None in row or None in row.values():
            raise ValueError(f"has a row whose number of cells is not that of the header: {row}")
        name = str(cells.pop("controller")).strip()
        if name in rows:
            raise ValueError(f"has two rows '{name}'")
        rows[name] = cells
    return rows


def _from_tree(path: str, text: str) -> dict[str, dict[str, Any]]:
    try:
        tree = json.loads(text) if Path(path).suffix == ".json" else inputs.from_yaml(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"is neither YAML nor JSON: {error}") from error
    if not isinstance(tree, dict) or not all(isinstance(row, dict) for row in tree.values()):
        raise ValueError(f"must hold {ROWS}, each with {COLUMNS}")
    return {str(name): row for name, row in tree.items()}


def _checked(rows: dict[str, dict[str, Any]]) -> dict[str, Indices]:
    if not rows:
        raise ValueError(f"is empty; it must hold {ROWS}")
    table = {}
    for name, row in rows.items():
        if name not in LAWS:
            raise ValueError(f"has a row '{name}'; it must hold {ROWS}")
        unknown = [key for key in row if key not in Indices._fields]
        if unknown:
            raise ValueError(f"has a column '{unknown[0]}' in row {name}; it must have {COLUMNS}")
        table[name] = Indices(*(_number(name, key, row.get(key)) for key in Indices._fields))
    if all(math.isnan(value) for row in table.values() for value in row):
        raise ValueError(f"has no number; it must have {COLUMNS}")
    return table


def _number(row: str, column: str, cell: Any) -> float:
    if cell is None or (isinstance(cell, str) and not cell.strip()):
        return math.nan
    try:
        value = float(cell)
    except (TypeError, ValueError):
        value = math.nan
    if isinstance(cell, bool) or not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"has {cell!r} as {column} of {row}; it must be a positive number, or empty")
    return value
