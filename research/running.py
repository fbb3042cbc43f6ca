# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs a study of this folder as a command: one sentence for bad input, quiet at Ctrl-C."""

import argparse
import os
from collections.abc import Callable, Sequence

from valve_control import interrupts
from valve_control.cli.common import Parser, ended


def options(name: str, description: str, numbers: bool = True) -> Parser:
    """The parser of ``python -m research.NAME``; ``numbers``: its results can be had as JSON."""
    parser = Parser(prog=f"python -m research.{name}", description=description)
    if numbers:
        parser.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    return parser


def run(
    parser: Parser, work: Callable[[argparse.Namespace], int | None], argv: Sequence[str] | None = None
) -> int:
    """Parse ``argv`` (default: this process's), do ``work``, and return the exit status."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if argv is not None:
        return ended(parser.prog, parser.prog, lambda: work(parser.parse_args(argv)))
    interrupts.watch()
    status = ended(parser.prog, parser.prog, lambda: work(parser.parse_args()))
    interrupts.ignore()
    return interrupts.STATUS if interrupts.come() else status
