# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Adds to a registry the entries that other installed packages bring by entry points."""

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

T = TypeVar("T")  # a NamedTuple with name and package


def package_of(point: EntryPoint) -> str:
    """Name of the distribution that brings ``point``."""
    return point.dist.name if point.dist is not None else point.module


def add(
    group: str,
    kind: str,
    accepted: Callable[[Any, dict[str, T]], T],
    error: type[ValueError],
    known: dict[str, T],
) -> dict[str, str]:
    """Add to ``known`` what the entry points of ``group`` name; returns why others are left out, by name.

    ``kind``: what an entry is, in one word; ``accepted``: returns what was imported if it can be added to
    those that are known, and raises ``error`` with one sentence if not.
    """
    left_out: dict[str, str] = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        package = package_of(point)
        try:
            entry: Any = accepted(_imported(point, error), known)
        except error as reason:
            left_out[point.name] = f"the {kind} '{point.name}' of the package {package} is left out: {reason}"
        else:
            known[entry.name] = entry._replace(package=package)
    return left_out


def _imported(point: EntryPoint, error: type[ValueError]) -> Any:
    try:
        return point.load()
    except Exception as reason:
        raise error(f"it cannot be imported: {type(reason).__name__}: {reason}") from reason
