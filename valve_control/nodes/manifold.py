"""Node `manifold`: one process that hosts the controllers (or simulators) of several valves."""

import re
import sys
from typing import Any

from valve_control.nodes.adapter import ParameterSet
from valve_control.nodes.controller import Controller
from valve_control.nodes.loop import Worker, run
from valve_control.nodes.valve_simulator import ValveSimulator
from valve_control.parameters import build
from valve_control.parameters.table import MANIFOLD, ParameterError, Values

KINDS: dict[str, Any] = {"controller": Controller, "valve_simulator": ValveSimulator}
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*$")


def names(values: Values) -> list[str]:
    """Names of the valves. Raises ParameterError unless each can be a namespace and none comes twice."""
    valves = [str(name) for name in build.items(values, "valves")]
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


class Manifold(Worker):
    """Holds the list of valves; each has a node of its own, `<namespace>/<valve>/controller`."""

    def __init__(self) -> None:
        super().__init__("manifold")
        self._values: Values = {}
        ParameterSet(self, MANIFOLD, self._fixed, self._apply)

    def _fixed(self, values: Values) -> list[str]:
        if self._values and values != self._values:
            raise ParameterError("the valves of a running manifold do not change; start it again")
        return names(values)

    def _apply(self, values: Values, valves: list[str]) -> None:
        self._values = values

    def host(self) -> list[Any]:
        """Make the nodes of all valves."""
        kind = build.word(self._values, "node")
        space = self.get_namespace().rstrip("/")
        made = []
        valves = names(self._values)
        # What one valve's samples bring into the caches serves the others too.
        own = {"rehearses": len(valves) == 1} if kind == "controller" else {}
        for name in valves:
            # Remapping of the manifold's own name and namespace is not meant for the nodes in it.
            remap = ["--ros-args", "-r", f"__ns:={space}/{name}", "-r", f"__node:={kind}"]
            made.append(KINDS[kind](cli_args=remap, **own))
        self.get_logger().info(f"{len(made)} x {kind}: {', '.join(valves)}")
        return made


def make() -> list[Any]:
    """The manifold and the nodes in it."""
    manifold = Manifold()
    return [manifold, *manifold.host()]


def main() -> int:
    """Entry point of `ros2 run valve_control manifold`."""
    return run(make)


if __name__ == "__main__":
    sys.exit(main())
