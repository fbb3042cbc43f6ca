# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Decides which of the open windows may change the machine: one, and only with the token."""

import hmac

GONE = 5.0  # s without a sign of its window after which the place is free; a reload takes less


def right(token: str, given: str) -> bool:
    """Whether ``given`` is the token."""
    return hmac.compare_digest(token.encode(), given.encode())


class Writer:
    """The window that writes, by the name that the browser gives its tab."""

    def __init__(self) -> None:
        self._tab = ""
        self._seen = float("-inf")  # s  when it was last there

    def claim(self, tab: str, now: float, by_force: bool = False) -> bool:
        """Whether ``tab`` writes from ``now`` [s] on: if nobody does, it did before, or ``by_force``.

        Who writes says so again and again; else the place is free after a while.
        """
        if tab and (by_force or self._tab in ("", tab) or now > self._seen + GONE):
            self._tab, self._seen = tab, now
        return self.writes(tab)

    def writes(self, tab: str) -> bool:
        """Whether ``tab`` is the one that writes."""
        return bool(tab) and self._tab == tab
