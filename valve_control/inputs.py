# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks files before they are opened: refuses folders, and devices, which might never end. Reads YAML."""

import os
import re
from pathlib import Path
from typing import Any

import yaml

from valve_control.parameter import ParameterError

LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# What PyYAML raises: also for a date that does not exist, a tag that does not fit its value, deep nesting.
WRONG = (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError, RecursionError)


class _RosLoader(LOADER):  # type: ignore[misc]  # one of two classes
    """Reads numbers as rcl does: 1:30, 1_000 and 0b11, which are numbers of YAML 1.1, are words."""


_NUMBERS = {
    "tag:yaml.org,2002:int": re.compile(r"[-+]?(0[0-7]*|[1-9][0-9]*|0x[0-9a-fA-F]+)$"),
    "tag:yaml.org,2002:float": re.compile(
        r"[-+]?[0-9]+\.[0-9]*([eE][-+][0-9]+)?$|[-+]?\.[0-9]+([eE][-+][0-9]+)?$"
        r"|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"
    ),
}
_RosLoader.yaml_implicit_resolvers = {
    first: [(tag, _NUMBERS.get(tag, pattern)) for tag, pattern in known]
    for first, known in LOADER.yaml_implicit_resolvers.items()
}


def expanded(path: str, what: str) -> Path:
    """``path`` with the home folder for its ``~``. Raises ParameterError, ``what`` it is in the message."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise ParameterError(f"{what} {path}: there is no such user, or no home folder") from error


def check(path: str, what: str) -> None:
    """Raise ParameterError if ``path``, named ``what`` in the message, is neither file nor end of a pipe."""
    if os.path.exists(path) and not (os.path.isfile(path) or Path(path).is_fifo()):
        raise ParameterError(f"{what} {path!r} cannot be read: it is no file")


def from_yaml(text: str) -> Any:
    """What the YAML ``text`` holds for rcl. Raises ValueError with the reason in one line."""
    try:
        return yaml.load(text, _RosLoader)
    except WRONG as error:
        raise ValueError(" ".join(str(error).split())) from error
