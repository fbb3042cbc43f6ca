# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the error that says what is wrong with a bag, and refuses pointers to files."""

from pathlib import Path

LONGEST = 600  # characters
# How the small files begin that version control leaves in the place of large ones, and what fetches these.
POINTERS = {
    b"version https://git-lfs.github.com/spec/": ("a Git LFS pointer", "git lfs pull"),
    b"/annex/objects/": ("a git-annex pointer", "git annex get"),
}


class BagError(ValueError):
    """Says why a bag, or a part of it, cannot be used; the message is one sentence for the user.

    What it quotes from a damaged bag may be anything: it is brought to one line of bounded length.
    """

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def refuse_pointer(path: Path) -> None:
    """Raise BagError if ``path`` only stands for a file that was not fetched, OSError."""
    with path.open("rb") as stream:
        head = stream.read(100)
    for begin, (name, remedy) in POINTERS.items():
        if head.startswith(begin):
            raise BagError(f"{path} is {name}, not the file itself; run {remedy}")
