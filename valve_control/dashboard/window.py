# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the parts of a page need of the window that they are in."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

from valve_control.dashboard.machine import Machine
from valve_control.dashboard.programs import Programs
from valve_control.dashboard.valve import NodeState, Valve


class Window(Protocol):
    """One window with the valve that it shows, and with what it may."""

    machine: Machine
    programs: Programs
    folder: Path

    @property
    def valve(self) -> Valve | None:
        """The valve that is shown."""

    @property
    def controller(self) -> NodeState | None:
        """Its controller."""

    def allowed(self) -> bool:
        """Whether this window may change the machine now; if not, says so."""

    async def load(self, path: str) -> str:
        """Let the controller that is shown load a parameter file; its answer."""

    def tell(self, text: str, kind: str = "warning") -> None:
        """Show one sentence for a while."""

    def say(self, valve: Valve, text: str, mark: bool = False) -> None:
        """Write a line into a valve's log, and a mark into its plots."""

    def controls(self) -> AbstractContextManager[Any]:
        """What is made inside can be used only while this window writes."""
