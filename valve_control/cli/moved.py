# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tells where commands of earlier versions are now: research runs from a checkout and is not installed."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from valve_control.parameter import ParameterError

TARGETS = {
    "axes": "axis",
    "axis --delta": "delta",
    "compare --tuned": "tuned",
    "faults": "faults",
    "joiners": "joiners",
    "paper": "paper",
    "theorems": "theorems",
}  # former command → target of make in a checkout


def sentence(name: str) -> str:
    """One sentence that names the command that does this now."""
    return f"{name} is research and not installed; in a checkout of valve_control: make {TARGETS[name]}"


class Option(argparse.Action):
    """A former option: it refuses with the sentence, whatever stands beside it."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, default=False, help=argparse.SUPPRESS)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> NoReturn:
        """Exit with status 2."""
        command = f"{parser.prog.split()[-1]} {self.option_strings[0]}"
        parser.exit(2, f"valve-control: {sentence(command)}\n")


def add_commands(commands: Any) -> None:
    """Add the former commands, which do not appear in the help."""
    for name in ("axes", "paper", "theorems"):
        parser = commands.add_parser(name, help="", add_help=False, prefix_chars="\0")
        parser.add_argument("options", nargs=argparse.REMAINDER)
        parser.set_defaults(run=_refuse)


def _refuse(arguments: argparse.Namespace) -> NoReturn:
    raise ParameterError(sentence(arguments.task))


def main() -> int:
    """Entry point of the former executables `faults`, `joiners` and `paper`."""
    print(sentence(Path(sys.argv[0]).stem), file=sys.stderr)
    return 2
