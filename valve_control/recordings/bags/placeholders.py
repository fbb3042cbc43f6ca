# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tells the small files that version control leaves in the place of large ones."""

from pathlib import Path

from valve_control.recordings.bags.errors import BagError

# How they begin (https://github.com/git-lfs/git-lfs/blob/main/docs/spec.md, https://git-annex.branchable.com/internals/)
KINDS = {
    b"version https://git-lfs.github.com/spec/": ("a Git LFS pointer", "git lfs pull"),
    b"version https://hawser.github.com/spec/": ("a Git LFS pointer", "git lfs pull"),
    b"/annex/objects/": ("a git-annex pointer", "git annex get"),
}

HTML, DOCTYPE = b"<html", b"<!doctype html"  # of a server that asks for a password, or has no such file
BOM = b"\xef\xbb\xbf"
HEAD = 256  # bytes


class PlaceholderError(BagError):
    """Says that a file only stands for another one that was not fetched."""


def refuse(path: Path) -> None:
    """Raise PlaceholderError if ``path`` only stands for a file that was not fetched, OSError."""
    if path.is_symlink() and not path.exists():
        raise PlaceholderError(f"{path} is a link to {path.readlink()}, which does not exist")
    with path.open("rb") as stream:
        head = stream.read(HEAD).removeprefix(BOM).lstrip()
    if head[: len(HTML)].lower() == HTML or head[: len(DOCTYPE)].lower() == DOCTYPE:
        raise PlaceholderError(
            f"{path} is a page of a web server (HTML), not the file itself; fetch it again"
        )
    for begin, (name, remedy) in KINDS.items():
        if head.startswith(begin):
            raise PlaceholderError(f"{path} is {name}, not the file itself; run {remedy}")
