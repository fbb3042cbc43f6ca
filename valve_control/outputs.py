# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes files whole or not at all, and checks the paths of outputs before the work begins."""

import errno
import json
import math
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from valve_control.parameter import ParameterError


def check(paths: Sequence[str], inputs: Sequence[str] = ()) -> None:
    """Refuse outputs that cannot be written, or that would replace one of ``inputs`` or each other.

    Raises ParameterError, and OSError for a name that no file can have.
    """
    taken: set[str] = set()
    read = {os.path.realpath(path): path for path in inputs}
    for path in paths:
        if not path:
            raise ParameterError("an output has an empty name; give a file")
        whole = Path(os.path.realpath(path))
        ordinary = whole.is_file() or not whole.exists()
        for wrong, reason in (
            (not whole.parent.is_dir(), f"there is no folder {whole.parent}"),
            (path.endswith("/") or whole.is_dir(), "it is a folder"),
            (not os.access(whole.parent if ordinary else whole, os.W_OK), "permission denied"),
            (
                whole.is_file() and not (os.access(whole, os.W_OK) and whole.stat().st_mode & 0o222),
                "it is read-only",
            ),
        ):
            if wrong:
                raise ParameterError(f"{path} cannot be written: {reason}")
        if not ordinary:
            continue
        if str(whole) in taken:
            raise ParameterError(f"{path} is given for two outputs; each needs a file of its own")
        taken.add(str(whole))
        for real, name in read.items():
            if str(whole) == real or (whole.exists() and os.path.exists(real) and whole.samefile(real)):
                raise ParameterError(f"{path} is an input; it would be overwritten, so choose another output")
            if os.path.isdir(real) and whole.is_relative_to(real):
                raise ParameterError(f"{path} lies in {name}, which is an input; choose another folder")


def write(path: str, content: str | bytes) -> None:
    """Replace the file ``path`` by ``content``, whole or not at all. Raises OSError."""
    target = Path(os.path.realpath(path))
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        if target.exists() and not target.is_file():
            target.write_bytes(data)  # such as /dev/null
            return
        if target.exists() and not (os.access(target, os.W_OK) and target.stat().st_mode & 0o222):
            raise PermissionError(errno.EACCES, "it is read-only")
        with tempfile.NamedTemporaryFile(
            dir=target.parent, prefix=f".{target.name}.", delete=False
        ) as stream:
            try:
                stream.write(data)
                stream.flush()
                os.chmod(stream.name, 0o644)
                os.replace(stream.name, target)
            finally:  # at Ctrl-C too; without an error it is in its place already
                Path(stream.name).unlink(missing_ok=True)
    except OSError as error:
        error.filename = path
        raise


def printable(text: str) -> str:
    """``text`` for a message of ROS, which is UTF-8: bytes of a path that are not become question marks."""
    return text.encode(errors="replace").decode()


def shown(path: Path) -> str:
    """Absolute ``path`` for a message."""
    return printable(str(path.absolute()))


def as_json(result: Any) -> str:
    """JSON text of ``result``; NaN and infinity become null."""
    return json.dumps(plain(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """``value`` with lists for arrays and tuples, numbers of Python, and None for NaN and infinity."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):  # numpy's
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
