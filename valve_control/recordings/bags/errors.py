# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the error that says what is wrong with a bag."""

LONGEST = 600  # characters


class BagError(ValueError):
    """Says why a bag, or a part of it, cannot be used; the message is one sentence for the user.

    Text of a damaged bag, which may be anything, is cut to one line of bounded length.
    """

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
