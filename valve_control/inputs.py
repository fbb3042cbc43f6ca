# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks files before they are opened: refuses folders, and devices, which might never end. Reads YAML."""

from pathlib import Path
from typing import Any

import yaml

from valve_control.parameter import ParameterError

LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# What PyYAML raises: also for a date that does not exist, a tag that does not fit its value, deep nesting.
WRONG = (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError, RecursionError)


def expanded(path: str, what: str) -> Path:
    """``path`` with the home folder for its ``~``. Raises ParameterError, ``what`` it is in the message."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ParameterError(f"{what} {path}: there is no such user, or no home folder") from error


def check(path: str, what: str) -> None:
    """Raise ParameterError unless ``path``, named ``what`` in the message, is a file or the end of a pipe."""
    if not path:
        raise ParameterError(f"{what} has an empty name")
    if "\0" in path:
        raise ParameterError(f"{what} {path!r} cannot be read: a name has no zero in it")
    found = Path(path)
    try:
        if found.is_dir():
            raise ParameterError(f"{what} {path} cannot be read: it is a folder")
        if found.exists() and not (found.is_file() or found.is_fifo()):
            raise ParameterError(f"{what} {path} cannot be read: it is a device, not a file")
    except OSError as error:
        raise ParameterError(f"{what} {path} cannot be read: {error.strerror or error}") from error


def from_yaml(text: str) -> Any:
    """What the YAML ``text`` holds. Raises ValueError with the reason in one line."""
    try:
        return yaml.load(text, LOADER)
    except WRONG as error:
        raise ValueError(" ".join(str(error).split())) from error
