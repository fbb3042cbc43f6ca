# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs a study of this folder as a command: one sentence for bad input, quiet at Ctrl-C."""

import argparse
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

from valve_control import interrupts
from valve_control.cli.common import Parser, ended
from valve_control.control.analysis import figures

LAW_COLOURS = {
    **figures.LAW_COLOURS,
    "pid_plain": figures.COLOURS[1],
    "servo": figures.COLOURS[4],
    "pid_reference": figures.COLOURS[5],
    "oracle": "#BFBFBF",
}  # of each law and valve in all figures of this folder


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
    return interrupts.run(lambda: ended(parser.prog, parser.prog, lambda: work(parser.parse_args())))


def _begin(all_there: Any) -> None:
    """Begin a process of a pool."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    all_there.wait()


@contextmanager
def pool(processes: int, context: Any = None) -> Iterator[ProcessPoolExecutor]:
    """Pool of ``processes`` that ignore Ctrl-C and end at once if an exception leaves the block.

    All are there when the block begins. ``context``: of multiprocessing.
    """
    # Its start would let the signals through that are held back below.
    resource_tracker.ensure_running()
    # A process that has not yet come to its initializer would print a traceback.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    context = context or multiprocessing.get_context()
    # A pool starts no other process while one has nothing to do; it would do so when nothing is held back.
    executor = ProcessPoolExecutor(
        processes, context, initializer=_begin, initargs=(context.Barrier(processes),)
    )
    try:
        try:
            for _ in range(processes):
                executor.submit(int)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield executor
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    executor.shutdown()
