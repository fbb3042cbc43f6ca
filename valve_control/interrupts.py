# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Handles Ctrl-C: the command stops once, without a traceback, and no process that it started outlives it."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

STATUS = 130
AGAIN = 0.002  # s until an exception that was swallowed is raised again
# Modules whose Python code numba runs while it makes the record that a compiled function returns.
MAKING_RECORDS = ("namedtuple_", "numba.core.serialize")
_come = _decided = False
_watched: set[int] = set()
_held = 0  # blocks that hold signals back
_pending = 0  # signal that came meanwhile, 0 for none


def come() -> bool:
    """Whether Ctrl-C has been pressed since ``watch``."""
    return _come


def watch(*numbers: int) -> None:
    """Let the first of the signals ``numbers`` (SIGINT) raise KeyboardInterrupt; further ones do nothing.

    It is never raised while numba makes the record that a compiled function returns: the process would end
    with a segmentation fault, and a signal of the time in that function is delivered exactly then. Where the
    exception is swallowed (a callback of the garbage collector, an import), it is raised again. A signal that
    is ignored, as in a command that a script put into the background, stays so.
    """
    _watched.update(n for n in numbers or (signal.SIGINT,) if signal.getsignal(n) is not signal.SIG_IGN)
    if _watched:
        for number in (signal.SIGALRM, *_watched):
            signal.signal(number, _raise)
        sys.unraisablehook, sys.excepthook = _swallowed, _printed


def ignore() -> None:
    """Let the signals do nothing from now on: the exit status is decided."""
    global _decided
    _decided = True
    # Python ends a process by SIGINT if a KeyboardInterrupt was raised below the evaluation of a text, as the
    # making of a namedtuple is, and no other text was evaluated since (``run_eval_code_obj``, pythonrun.c).
    exec("")
    # At its end Python gives handlers of its own back to the system, but leaves what is ignored.
    for number in (signal.SIGINT, signal.SIGALRM, *_watched):
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def held_back() -> Iterator[None]:
    """Let the signals come when the block has ended: within it a child is started, or a machine set back.

    They are not blocked, for the child would be born so.
    """
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
    elif not _decided and (number == signal.SIGALRM or not _come):
        _come = True
        caller = _gets_a_record(frame)
        if caller is None:
            raise KeyboardInterrupt
        _raise_in(caller)


def _gets_a_record(frame: Any) -> Any:
    """The frame for which a compiled function makes a record at present, None if none does."""
    making = False
    while frame:
        here = str(frame.f_globals.get("__name__")).startswith(MAKING_RECORDS)
        if making and not here:
            return frame
        making, frame = here, frame.f_back
    return None


def _raise_in(frame: Any) -> None:
    """Raise KeyboardInterrupt as soon as ``frame`` goes on.

    A signal could come too late for it, during the next compiled function, again and again.
    """

    def interrupt(frame: Any, event: str, argument: Any) -> None:
        frame.f_trace = None
        sys.settrace(None)
        raise KeyboardInterrupt

    sys.settrace(lambda *unused: None)  # without one for all frames that of a single frame is not called
    frame.f_trace = interrupt


def _swallowed(unraisable: Any) -> None:
    if not _decided and issubclass(unraisable.exc_type, KeyboardInterrupt):
        # Raised here it would be swallowed once more.
        signal.setitimer(signal.ITIMER_REAL, AGAIN)
    elif not (_come or _decided):  # what Ctrl-C left half made complains when it is collected
        sys.__unraisablehook__(unraisable)


def _printed(kind: type[BaseException], error: BaseException, trace: Any) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
