"""Runs a study of this folder as a command: one sentence for bad input, quiet at Ctrl-C."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from valve_control.cli import streams
from valve_control.cli.common import Parser, ended


def options(name: str, description: str) -> Parser:
    """The parser of ``python -m research.NAME``."""
    return Parser(prog=f"python -m research.{name}", description=description)


def run(
    parser: Parser, work: Callable[[argparse.Namespace], int | None], argv: Sequence[str] | None = None
) -> int:
    """Parse ``argv`` (default: this process's), do ``work``, and return the exit status."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if argv is None:
        streams.prepare()
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    return ended(parser.prog, parser.prog, lambda: work(arguments))
