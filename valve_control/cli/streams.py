# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes standard output and standard error of this process such that any text can be printed."""

import codecs
import os
import sys
import unicodedata

# What a terminal of ASCII shows in place of what has no letters in its name or no ASCII in its decomposition.
ASCII = {
    "−": "-", "–": "-", "—": "-", "→": "->", "·": "*", "×": "x", "±": "+-", "≤": "<=", "≥": ">=", "⁄": "/",
    "°": " deg", "µ": "u", "‖": "||", "√": "sqrt", "∂": "d", "∫": "int", "⌈": "ceil(", "⌉": ")",
}  # fmt: skip


def prepare() -> None:
    """Let closed streams take what is printed and drop it, and streams of few characters spell the others."""
    # No file that is opened later may take the number of a closed stream.
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(descriptor)
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8")  # noqa: SIM115  # for as long as the process lives
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8")  # noqa: SIM115
    codecs.register_error("spelled", _spelled)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="spelled")


def _spelled(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(spelled, error.object[error.start : error.end])), error.end


def spelled(character: str) -> str:
    """``character`` in ASCII: letters without their accents, Greek ones by their names."""
    name = unicodedata.name(character, "")
    if character in ASCII:
        return ASCII[character]
    if name.startswith("GREEK") and " LETTER " in name:
        word = name.partition(" LETTER ")[2].partition(" ")[0].lower()
        return word.capitalize() if "CAPITAL" in name else word
    parts = unicodedata.normalize("NFKD", character)
    if parts == character:
        return "" if unicodedata.combining(character) else "?"
    return "".join(part if part.isascii() else spelled(part) for part in parts)
