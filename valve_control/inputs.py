# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks files before they are opened: refuses folders, and devices, which might never end."""

from pathlib import Path

from valve_control.parameter import ParameterError


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
