# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists all control laws by name: those of this package, and those of other packages that are installed.

Another package adds a law by an entry point of the group ``valve_control.laws`` that names a ``Law``.
"""

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from valve_control.control import compiling
from valve_control.control.laws import arc, compensator, dcarc, oarc, open_loop, pid, reshaping
from valve_control.control.laws.common import COMMON
from valve_control.control.laws.law import Law, LawError, check, try_out
from valve_control.parameter import defaults

GROUP = "valve_control.laws"


def _plugged_in(point: EntryPoint, taken: dict[str, Law]) -> Law:
    """The law of ``point``. Raises LawError."""
    try:
        found = point.load()
    except Exception as error:
        raise LawError(f"it cannot be imported: {type(error).__name__}: {error}") from error
    law = check(found)
    if law.name in taken:
        raise LawError(f"the name is taken by a law of {taken[law.name].package}")
    try_out(law, {**defaults(COMMON), **defaults(reshaping.PARAMETERS)})
    source = getattr(law.module, "__file__", None)
    if source is not None:
        compiling.add_sources(law.module.__name__.split(".")[0], Path(source).parent)
    return law._replace(package=point.dist.name if point.dist is not None else point.module)


def _all() -> tuple[dict[str, Law], dict[str, str]]:
    laws = {law.name: law for law in (arc.LAW, oarc.LAW, dcarc.LAW, pid.LAW, compensator.LAW, open_loop.LAW)}
    refused: dict[str, str] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        package = point.dist.name if point.dist is not None else point.module
        try:
            law = _plugged_in(point, laws)
        except LawError as error:
            refused[point.name] = f"the law '{point.name}' of the package {package} is left out: {error}"
        else:
            laws[law.name] = law
    return laws, refused


LAWS, LEFT_OUT = _all()  # LEFT_OUT: why, as a sentence
REFUSED = list(LEFT_OUT.values())
ADAPTIVE = tuple(law.name for law in LAWS.values() if law.estimates_valve)
