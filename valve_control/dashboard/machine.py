# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Collects all valves, and changes them for the page: each change as a whole, or refused with its reason."""

import asyncio
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple, Protocol

from valve_control.dashboard.changes import Change, differing
from valve_control.dashboard.valve import NodeState, Valve
from valve_control.parameter import Values

REFUSED = "refused to deactivate"  # end of the answer of a node that is not active


class Answer(NamedTuple):
    """Answer to a request: whether it was done, and one sentence."""

    done: bool
    text: str


class Link(Protocol):
    """The way to the nodes. All of it may be called from any thread."""

    def set_parameters(self, node: str, values: Values) -> "Future[str]":
        """Set all ``values`` of ``node`` or none; the reason of a refusal, "" if they are in force."""

    def trigger(self, service: str) -> "Future[Answer]":
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
            if namespace not in self.valves:
                self.valves[namespace] = Valve(namespace)
            return self.valves[namespace]

    def note(self, valve: Valve, node: NodeState, change: Change | None, asked: float) -> None:
        """Say a change in the log, mark it in the plots."""
        if change is not None:
            where = "" if node is valve.controller else f"{node.name}: "
            valve.say(change.time, "info", f"{where}{change.text} ({change.origin})")
            valve.mark_change(change, where, asked)

    def observed(self, valve: Valve, node: NodeState, values: Values) -> None:
        """Take in values that a node says it has. What others changed can be undone too."""
        with self.lock:
            now = time.time()
            change = node.observed(values, now)
            if change is not None:
                node.changes.add(change)
            self.note(valve, node, change, now)

    async def change(self, valve: Valve, node: NodeState, values: Values, origin: str = "here") -> str:
        """Set ``values`` together; the reason if they are refused, else ""."""
        async with node.turn:
            return await self._change(valve, node, values, origin)

    async def _change(self, valve: Valve, node: NodeState, values: Values, origin: str) -> str:
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
            if node.asking:
                return (
                    f"{node.name} was started anew and has not told its parameters yet; nothing was changed",
                    None,
                )
            wanted = differing(node.values, values)
            for name in values.keys() - wanted.keys():
                node.drafts.pop(name, None)
                node.refusals.pop(name, None)
            node.version += 1
            if not wanted:
                return "", None
            if not node.present:
                return f"{node.name} is gone; nothing was changed", None
            asked = time.time()
            node.asks(wanted, asked)
        reason = await asyncio.wrap_future(self.link.set_parameters(node.name, wanted))
        now = time.time()
        with self.lock:
            change = node.asked(wanted, reason, now, origin)
            if reason:
                valve.say(now, "warning", f"refused: {reason}")
            self.note(valve, node, change, asked)
        return reason, change

    async def undo(self, valve: Valve, node: NodeState) -> str:
        """Take back the newest change; a sentence if that was not done, else ""."""
        changes = node.changes
        return await self._step(valve, node, "undo", changes.done, changes.back, changes.went_back)

    async def redo(self, valve: Valve, node: NodeState) -> str:
        """Make the change again that was taken back last; a sentence if that was not done, else ""."""
        changes = node.changes
        return await self._step(valve, node, "redo", changes.undone, changes.forth, changes.went_forth)

    async def _step(
        self,
        valve: Valve,
        node: NodeState,
        name: str,
        steps: list[Change],
        values: Callable[[], Values],
        went: Callable[[], None],
    ) -> str:
        async with node.turn:
            wanted, count = values(), len(steps)
            if not wanted:
                return f"there is nothing to {name}"
            reason, _ = await self._set(valve, node, wanted, name)
            with self.lock:
                if not reason and len(steps) == count:
                    went()
            return reason

    def keep(self, valve: Valve, node: NodeState, which: str) -> str:
        """Keep the present values as set A or B; a sentence for the log."""
        with self.lock:
            node.comparison.keep(which, node.tuned())
            node.version += 1
            text = f"kept the present values as {which}"
            valve.say(time.time(), "info", text)
        return text

    async def switch(self, valve: Valve, node: NodeState) -> str:
        """Go from set A to set B or back; a sentence if that was not done, else ""."""
        async with node.turn:
            which = node.comparison.other()
            if not which:
                return "keep one set as A and another as B first"
            reason = await self._change(valve, node, node.comparison.sets[which], f"set {which}")
            if not reason:
                with self.lock:
                    node.comparison.active = which
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
        said = []
        for valve, node, future in asked:
            answer = await asyncio.wrap_future(future)
            with self.lock:
                now = time.time()
                if node.state in ("inactive", "unconfigured") and answer.text.endswith(REFUSED):
                    continue
                valve.mark(now, "stop")
                if answer.done:
                    node.state = "inactive"
                    valve.say(now, "warning", "stopped from the page: the controller is inactive, 0 V")
                else:
                    valve.say(now, "error", f"NOT stopped: {answer.text}")
                    said.append(f"{node.name} was not stopped: {answer.text}")
        return said

    async def activate(self, valve: Valve, node: NodeState) -> str:
        """Let a stopped controller work again; a sentence if that was not done, else ""."""
        answer = await asyncio.wrap_future(self.link.transition(node.name, "activate"))
        with self.lock:
            now = time.time()
            if answer.done:
                node.state = "active"
                valve.mark(now, "active")
                valve.say(now, "info", "the controller is active again")
                return ""
        return answer.text

    async def trigger(self, valve: Valve, node: NodeState, service: str) -> Answer:
        """Call one of a node's services; its answer stands in the log too."""
        answer = await asyncio.wrap_future(self.link.trigger(f"{node.name}/{service}"))
        with self.lock:
            valve.say(time.time(), "info" if answer.done else "warning", answer.text)
        return answer
