# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists all control laws by name: those of this package, and those of other packages that are installed.

Another package adds a law by an entry point of the group ``valve_control.laws`` that names a ``Law``.
"""

from functools import partial

from valve_control.control import compiling, plugins
from valve_control.control.laws import arc, compensator, dcarc, oarc, open_loop, pid
from valve_control.control.laws.common import COMMON
from valve_control.control.laws.law import Law, try_out
from valve_control.control.laws.linearisation import built as linearised
from valve_control.control.laws.reshaping import PARAMETERS as RESHAPING
from valve_control.parameter import defaults

GROUP = "valve_control.laws"


def accepted(found: object, taken: dict[str, Law]) -> Law:
    """``found`` if it is a law that works and whose name is free. Raises PluginError."""
    law = plugins.check(found, Law)
    if law.name in taken:
        raise plugins.PluginError(f"the name is taken by a law of {taken[law.name].package}")
    if getattr(law.module, "__file__", None) is None:
        raise plugins.PluginError("it is in no file; write it into one, such as my_law.py, and import that")
    try_out(law, {**defaults(COMMON), **defaults(RESHAPING)})
    compiling.add_sources(law.module)
    return law


def usable(law: Law, package: str, taken: dict[str, Law]) -> Law:
    """``law`` of a ``package`` as LAWS has it. Raises PluginError, or what ``law`` raises."""
    return accepted(law, taken)._replace(package=package, build=partial(linearised, law.build))


BUILT_IN = (arc, oarc, dcarc, pid, compensator, open_loop)
LAWS: dict[str, Law] = {module.LAW.name: module.LAW for module in BUILT_IN}
LEFT_OUT = plugins.add(GROUP, "law", accepted, LAWS)  # why, as a sentence
for _name, _law in LAWS.items():  # the limit of its voltage is behind the curve of linearisation
    LAWS[_name] = _law._replace(build=partial(linearised, _law.build))
ADAPTIVE = tuple(law.name for law in LAWS.values() if law.estimates_valve)
