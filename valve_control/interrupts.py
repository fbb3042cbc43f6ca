# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Handles Ctrl-C: the command stops once, without a traceback, and no process that it started outlives it."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

STATUS = 130
_come = _pending = 0  # the signal that stops the command, and one that came while signals are held back
_held = 0  # blocks that hold signals back


def come() -> bool:
    """Whether Ctrl-C stops the command."""
    return _come > 0


def watch(*numbers: int) -> None:
    """Let the first of the signals ``numbers`` (SIGINT) raise KeyboardInterrupt; further ones do nothing.

    Where Python swallows the exception (a callback of the garbage collector), it is raised again. A signal
    that is ignored, as in a command that a script put into the background, stays so.
    """
    for number in numbers or (signal.SIGINT,):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _raise)
    sys.unraisablehook = _swallowed


def run(work: Callable[[], int], *numbers: int) -> int:
    """Exit status of ``work``, or STATUS if one of the signals ``numbers`` (SIGINT) stopped it."""
    watch(*numbers)
    try:
        status = work()
    except BaseException:  # a compiled module that is interrupted in its import raises an ImportError
        if not _come:
            raise
    finally:  # at its end Python gives handlers of its own back to the system, but leaves what is ignored
        for number in numbers or (signal.SIGINT,):
            signal.signal(number, signal.SIG_IGN)
    return STATUS if _come else status


@contextmanager
def held_back() -> Iterator[None]:
    """Let the signals come when the block has ended; they are not blocked, for a child would be born so."""
    global _held, _pending
    _held += 1
    try:
        yield
    finally:
        _held -= 1
        if _pending and not _held:
            number, _pending = _pending, 0
            signal.raise_signal(number)


def _raise(number: int, frame: Any) -> None:
    global _come, _pending
    if _held:
        _pending = number
    elif not _come:
        _come = number
        raise KeyboardInterrupt


def _swallowed(unraisable: Any) -> None:
    global _come
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.002, signal.raise_signal, [_come]).start()
        _come = 0
    elif not _come:  # what Ctrl-C left half made complains when it is collected
        sys.__unraisablehook__(unraisable)
