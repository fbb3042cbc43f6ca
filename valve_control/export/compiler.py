# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds and runs the C compiler."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from valve_control.export.sources import FLAGS
from valve_control.parameter import ParameterError


def find() -> list[str]:
    """The compiler's command: that of the variable CC, else cc, gcc or clang. Raises ParameterError."""
    wanted = shlex.split(os.environ.get("CC", ""))
    for words in [wanted] if wanted else [["cc"], ["gcc"], ["clang"]]:
        if shutil.which(words[0]):
            return words
    missing = wanted[0] if wanted else "cc, gcc or clang"
    raise ParameterError(
        f"this needs a C compiler, and there is no {missing} (Debian, Ubuntu: apt install gcc)"
    )


def build(inputs: Sequence[Path], output: Path, options: Sequence[str]) -> None:
    """Compile ``inputs`` into ``output``. Raises ParameterError with the first complaint."""
    run([*find(), *FLAGS.split(), *options, *map(str, inputs), "-lm", "-o", str(output)])


def run(command: Sequence[str]) -> str:
    """Run ``command``; returns what it says. Raises ParameterError if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = [line for line in (done.stderr or done.stdout).splitlines() if "error" in line]
        said += (done.stderr or done.stdout).strip().splitlines() or [f"status {done.returncode}"]
        raise ParameterError(f"{Path(command[0]).name} failed: {said[0]}")
    return done.stdout
