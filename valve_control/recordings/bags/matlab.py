# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads vectors of numbers out of MATLAB files up to version 7 (.mat)."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from valve_control.recordings.bags.columns import Column
from valve_control.recordings.bags.errors import BagError

NUMBERS = "biuf"  # kinds of numpy


def read(path: Path) -> list[Column]:
    """Vectors and columns of matrices: ``name``, ``structure.field``, ``cell(2)`` or ``matrix(:,3)``.

    Raises BagError if the file cannot be read or has no vector of numbers.
    """
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            content: dict[str, Any] = loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise BagError(
            f"{path} is a MATLAB file of version 7.3 (HDF5); save it in MATLAB with the option -v7"
        ) from error
    except OSError:
        raise
    except Exception as error:  # scipy raises what it meets
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BagError(f"{path} is not a MATLAB file that can be read: {reason}") from error
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    found = [column for name, value in variables.items() for column in _columns(name, value)]
    if not found:
        has = ", ".join(f"{name} ({_kind(value)})" for name, value in variables.items())
        raise BagError(
            f"{path} has no vector of numbers; it has {has or 'no variables'} (of a timeseries or "
            "table, save Time and Data as vectors of their own)"
        )
    return found


def _kind(value: Any) -> str:
    return f"{value.dtype} array" if isinstance(value, np.ndarray) else type(value).__name__


def _columns(name: str, value: Any) -> Iterator[Column]:
    if isinstance(value, dict):
        for field, content in value.items():
            yield from _columns(f"{name}.{field}", content)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object and value.ndim):
        for i, content in enumerate(value, start=1):
            yield from _columns(f"{name}({i})", content)
    elif isinstance(value, np.ndarray) and value.dtype.kind in f"{NUMBERS}c":
        if value.ndim == 1:
            yield _column(name, value)
        elif value.ndim == 2 and value.size:
            upright = value.shape[0] >= value.shape[1]
            for i, vector in enumerate(value.T if upright else value, start=1):
                yield _column(f"{name}(:,{i})" if upright else f"{name}({i},:)", vector)


def _column(name: str, vector: Any) -> Column:
    filled = np.ones(len(vector), dtype=np.bool_)
    if vector.dtype.kind not in NUMBERS:
        return Column(name, np.zeros(len(vector)), filled, f"column {name} holds complex numbers")
    return Column(name, vector.astype(np.float64), filled)
