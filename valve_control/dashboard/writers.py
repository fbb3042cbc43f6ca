"""Decides which of the open windows may change the machine: one, and only with the token."""

import hmac

GONE = 4.0  # s without its window after which the place is free; a reload takes less


def right(token: str, given: str) -> bool:
    """Whether ``given`` is the token."""
    return hmac.compare_digest(token.encode(), given.encode())


class Writer:
    """The window that writes, by the name that the browser gives its tab."""

    def __init__(self) -> None:
        self._tab = ""
        self._left = float("inf")  # s  when its window was closed

    def claim(self, tab: str, now: float, by_force: bool = False) -> bool:
        """Whether ``tab`` writes from ``now`` [s] on: if nobody does, it did before, or ``by_force``."""
        free = self._tab in ("", tab) or now > self._left + GONE
        if free or by_force:
            self._tab, self._left = tab, float("inf")
        return self._tab == tab

    def writes(self, tab: str) -> bool:
        """Whether ``tab`` is the one that writes."""
        return bool(tab) and self._tab == tab

    def left(self, tab: str, now: float) -> None:
        """Note at ``now`` [s] that the window of ``tab`` was closed or is loaded anew."""
        if self._tab == tab:
            self._left = now
