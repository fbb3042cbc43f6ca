# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Puts all sub-commands into one parser, and turns their errors into one sentence and an exit status.

A file of this folder that has a function ``add_commands`` adds its commands by itself.
"""

import argparse
import importlib
import os
import pkgutil
import re
import sys
import textwrap
from collections.abc import Sequence
from typing import Any

from valve_control import __version__
from valve_control.cli.common import Parser, check_outputs, ended, give_way
from valve_control.control.laws.registry import LEFT_OUT

EXAMPLES = """examples:
  valve-control identify --set lvdt.noise=0.005 --output valve.yaml --figure bode.png
  valve-control simulate --controller oarc --scenario sine --set frequency=6.0 --figure sine.png
  valve-control tune --controller dcarc --params-file valve.yaml --output tuned.yaml
  valve-control export --controller oarc --params-file config/d3fxe.yaml --output oarc_in_c
  valve-control analyze my_bag --html report.html
  valve-control simulate --command my_bag --set arc.k1=150
"""

GROUPS = {  # of the help, with their commands
    "your valve": ("identify", "parameters"),
    "simulate": ("simulate", "compare", "study", "tune", "margins", "axis", "demo"),
    "the machine": ("commission", "export"),
    "recordings": ("analyze", "replay", "bag"),
}
SEARCHES = ("identify", "study", "tune")  # that give way to a loop; commission, which is one, does it itself
WIDTH = 78  # columns of the list of commands


class Commands:
    """The command's parser ``top`` with one parser for each sub-command; the help groups them by task."""

    def __init__(self) -> None:
        self.top = Parser(
            prog="valve-control",
            usage="valve-control [-h] [--version] COMMAND ...",
            description="Local control of a proportional directional control valve: identify, simulate "
            "and tune a valve,\nand analyse recordings. valve-control COMMAND --help lists the options "
            "of a command.",
            epilog=EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        self.top.add_argument("--version", action="version", version=f"valve-control {__version__}")
        self._commands = self.top.add_subparsers(
            dest="task", required=True, metavar="COMMAND", prog="valve-control", help=argparse.SUPPRESS
        )
        self.parsers: dict[str, argparse.ArgumentParser] = {}
        self._texts: dict[str, str] = {}
        for module in pkgutil.iter_modules([os.path.dirname(__file__)]):
            if module.name not in ("__main__", "command"):
                part = importlib.import_module(f"valve_control.cli.{module.name}")
                if hasattr(part, "add_commands"):
                    part.add_commands(self)
        for title, names in GROUPS.items():
            self.top.add_argument_group(title, "\n".join(map(self._line, names)))

    def add_parser(self, name: str, help: str, **options: Any) -> argparse.ArgumentParser:
        """Add and return the parser of the sub-command ``name``; ``help`` is its line in the list."""
        parser: argparse.ArgumentParser = self._commands.add_parser(name, allow_abbrev=False, **options)
        self.parsers[name], self._texts[name] = parser, help
        return parser

    def _line(self, name: str) -> str:
        head = f"{name:<13}"
        return textwrap.fill(
            head + self._texts[name], WIDTH, subsequent_indent=" " * len(head), break_on_hyphens=False
        )


def run(argv: Sequence[str], alone: bool = False) -> int:
    """Run the command with ``argv``; returns the exit status. ``alone``: the process does nothing else."""
    # For small matrices BLAS threads that wait for each other take four times as long on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    commands = Commands()
    arguments, stray = commands.top.parse_known_args(argv, argparse.Namespace(line=list(argv)))
    if stray:
        commands.parsers[arguments.task].error(f"unrecognized arguments: {' '.join(stray)}")
    asked = {word for given in argv for word in re.split("[=,]", given)}
    for name, sentence in LEFT_OUT.items():
        if name not in asked:  # else it is the refusal
            print(f"valve-control: {sentence}", file=sys.stderr)
    if alone and arguments.task in SEARCHES:
        give_way(arguments)
    return ended("valve-control", arguments.task, lambda: arguments.run(check_outputs(arguments)))
