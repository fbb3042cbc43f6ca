"""What one does with a valve from the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

if TYPE_CHECKING:
    from valve_control.dashboard.page import Page


class Doing:
    """The part of the page that commands, records and runs."""

    def __init__(self, page: Page) -> None:
        self._page = page
        ui.label("nothing yet")

    def show(self) -> None:
        """Show another valve."""

    def refresh(self) -> None:
        """Show what has changed."""
