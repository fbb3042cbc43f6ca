# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Collects all valves, and changes them for the page: each change as a whole, or refused with its reason."""

import asyncio
import threading
import time
from concurrent.futures import Future
from typing import NamedTuple, Protocol

from valve_control.dashboard.changes import Change, differing
from valve_control.dashboard.valve import NodeState, Valve
from valve_control.parameter import Values

RESTING = ("inactive", "unconfigured")  # states of a node that gives no voltage


class Answer(NamedTuple):
    """Answer to a request: whether it was done, and one sentence."""

    done: bool
    text: str
    heard: bool = True  # whether the node itself has answered


class Link(Protocol):
    """The way to the nodes. All of it may be called from any thread."""

    def set_parameters(self, node: str, values: Values) -> "Future[Answer]":
        """Set all ``values`` of ``node`` or none."""

    def trigger(self, node: str, service: str) -> "Future[Answer]":
        """Call a service of type std_srvs/Trigger."""

    def transition(self, node: str, name: str) -> "Future[Answer]":
        """Lead a managed node through a transition such as activate."""


class Machine:
    """All valves on the graph. ``lock`` protects them: data come in one thread, the page reads in another."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self.lock = threading.RLock()
        self.valves: dict[str, Valve] = {}

    def valve(self, namespace: str) -> Valve:
        """The valve in ``namespace``, made if it is new."""
        with self.lock:
            return self.valves.setdefault(namespace, Valve(namespace))

    def observed(self, valve: Valve, node: NodeState, values: Values) -> None:
        """Take in values that a node says it has. What others changed can be undone too."""
        with self.lock:
            now = time.time()
            change = node.observed(values, now)
            if change is not None:
                node.changes.add(change, now)
            valve.note(node, change, now)

    async def change(self, valve: Valve, node: NodeState, values: Values, origin: str = "here") -> str:
        """Set ``values`` together; the reason if they are refused, else ""."""
        async with node.turn:
            asked = time.time()
            reason, change = await self._set(valve, node, values, origin)
            if change is not None:
                with self.lock:
                    node.changes.add(change, asked)
            return reason

    async def _set(
        self, valve: Valve, node: NodeState, values: Values, origin: str
    ) -> tuple[str, Change | None]:
        with self.lock:
            if node.asking or not node.present:
                state = "was started anew and has not told its parameters yet" if node.asking else "is gone"
                return f"{node.name} {state}; nothing was changed", None
            wanted = differing(node.values, values)
            if not wanted:
                return "", None
            asked = time.time()
            node.asks(wanted, asked)
        answer = await asyncio.wrap_future(self.link.set_parameters(node.name, wanted))
        with self.lock:
            now = time.time()
            if not answer.done:
                valve.say(now, "warning", f"refused: {answer.text}")
                return answer.text, None
            change = node.take(wanted, now, origin)
            valve.note(node, change, asked)
            return "", change

    async def act(self, valve: Valve, node: NodeState, act: str) -> str:
        """Undo the newest change, or redo the one that was undone last; a sentence if it failed, or ""."""
        async with node.turn:
            change = node.changes.newest(act)
            if change is None:
                return f"there is nothing to {act}"
            wanted = change.before if act == "undo" else change.after
            reason, _ = await self._set(valve, node, wanted, act)
            with self.lock:
                if not reason:
                    node.changes.acted(act, change)
                    node.version += 1
            return reason

    async def stop(self) -> list[str]:
        """Switch every controller off, which gives 0 V; a sentence for each that did not do so."""
        with self.lock:
            nodes = [(v, v.controller) for v in self.valves.values() if v.controller is not None]
        # Also one that is known to rest: somebody may have activated it since it said so.
        asked = [
            (valve, node, self.link.transition(node.name, "deactivate"))
            for valve, node in nodes
            if node.present
        ]
        failures = []
        for valve, node, future in asked:
            answer = await asyncio.wrap_future(future)
            with self.lock:
                now = time.time()
                if answer.done:
                    node.state = "inactive"
                    valve.mark(now, "stop")
                    valve.say(now, "warning", "stopped from the page: the controller is inactive, 0 V")
                elif not (answer.heard and node.state in RESTING):
                    valve.mark(now, "stop")
                    valve.say(now, "error", f"NOT stopped: {answer.text}")
                    failures.append(f"{node.name} was not stopped: {answer.text}")
        return failures

    async def activate(self, valve: Valve, node: NodeState) -> str:
        """Let a stopped controller work again; a sentence if that was not done, else ""."""
        answer = await asyncio.wrap_future(self.link.transition(node.name, "activate"))
        if not answer.done:
            return answer.text
        with self.lock:
            node.state = "active"
            valve.mark(time.time(), "active")
            valve.say(time.time(), "info", "the controller is active again")
        return ""

    async def trigger(self, valve: Valve, node: NodeState, service: str) -> Answer:
        """Call one of a node's services; its answer stands in the log too."""
        answer = await asyncio.wrap_future(self.link.trigger(node.name, service))
        with self.lock:
            valve.say(time.time(), "info" if answer.done else "warning", answer.text)
        return answer
