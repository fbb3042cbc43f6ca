# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `manifold`: one process with the controllers of several valves."""

import re
import sys
from collections.abc import Sequence
from typing import Any

from valve_control.control.parameters.table import MANIFOLD
from valve_control.nodes.adapter import ParameterSet, admit, has_override
from valve_control.nodes.controller_node import Controller
from valve_control.nodes.loop import Worker, run
from valve_control.parameter import ParameterError, Values, items

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*$")


def names(values: Values) -> list[str]:
    """Names of the valves. Raises ParameterError unless each is a valid namespace and none comes twice."""
    valves = [str(name) for name in items(values, "valves")]
    for name in valves:
        if not NAME.match(name):
            raise ParameterError(
                f"valves names '{name}'; a name begins with a letter and has letters, digits and _ only"
            )
        if valves.count(name) > 1:
            raise ParameterError(f"valves names '{name}' twice; each valve needs a name of its own")
    if not valves:
        raise ParameterError("valves is empty; it must name at least one valve")
    return valves


def _beside(controllers: Sequence[str]) -> bool:
    """Whether ``controllers`` (full names) have a driver. Raises ParameterError if only some have."""
    given = [has_override("controller", "driver", remapped(name)) for name in controllers]
    if any(given) and not all(given):
        raise ParameterError(
            f"{controllers[given.index(False)]} has no parameter driver, other valves of the manifold "
            "have one; either all valves have a driver, or none"
        )
    return all(given)


def remapped(name: str) -> list[str]:
    """Arguments of a node of the full ``name``; remapping of the manifold itself is not meant for it."""
    space, _, node = name.rpartition("/")
    return ["--ros-args", "-r", f"__ns:={space}", "-r", f"__node:={node}"]


class Manifold(Worker):
    """Node with the list of valves; each valve has a node of its own, `<namespace>/<valve>/controller`."""

    def __init__(self) -> None:
        super().__init__("manifold")
        fixed = {parameter.name for parameter in MANIFOLD}
        self._settings = ParameterSet(self, MANIFOLD, names, alone=False, fixed=fixed)

    def host(self) -> list[Any]:
        """Create the nodes of all valves."""
        valves, space = self._settings.built, self.get_namespace().rstrip("/")
        hosts = [f"{space}/{name}/controller" for name in valves]
        kind: type[Controller] = Controller
        if _beside(hosts):
            from valve_control.nodes.device_controller import DeviceController  # which brings all drivers

            kind = DeviceController
        admit(self, {self.get_fully_qualified_name(): MANIFOLD, **dict.fromkeys(hosts, kind.table)})
        made = [kind(alone=False, cli_args=remapped(host)) for host in hosts]
        self.get_logger().info(f"{len(made)} controllers: {', '.join(valves)}")
        return made


def make() -> list[Any]:
    """Create the manifold and the nodes of its valves."""
    manifold = Manifold()
    return [manifold, *manifold.host()]


def main() -> int:
    """Entry point of `ros2 run valve_control manifold`."""
    return run(make)


if __name__ == "__main__":
    sys.exit(main())
