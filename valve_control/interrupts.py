# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Handles Ctrl-C: the command stops once, without a traceback, and no process that it started outlives it."""

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

STATUS = 130
OURS = ("valve_control.", "research.")
# Libraries are left time to come back to this package before KeyboardInterrupt is raised in their code, s.
GRACE = 0.5
# Time from one look at where the command is to the next, s.
LOOK = 0.002
# Modules whose Python code numba runs while it makes the record that a compiled function returns.
MAKING_RECORDS = ("namedtuple_", "numba.core.serialize")
_since: float | None = None
_decided = False
_watched: set[int] = set()


def come() -> bool:
    """Whether Ctrl-C has been pressed since ``watch``."""
    return _since is not None


def watch(*numbers: int) -> None:
    """Let the first of the signals ``numbers`` (SIGINT) raise KeyboardInterrupt; further ones do nothing.

    It is raised in code of this package; in a library only if that does not come back within ``GRACE`` (a
    compilation, a figure), and never while numba makes the record that a compiled function returns: the
    process would end with a segmentation fault, and a signal of the time in that function is delivered
    exactly then. Where the exception is swallowed (a callback of the garbage collector, an import), it is
    raised again. A signal that is ignored, as in a command that a script put into the background, stays so.
    """
    _watched.update(n for n in numbers or (signal.SIGINT,) if signal.getsignal(n) is not signal.SIG_IGN)
    if not _watched:
        return
    for number in (signal.SIGALRM, *_watched):
        signal.signal(number, _raise)
    sys.unraisablehook = _swallowed
    sys.excepthook = _printed


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
    """Let the signals come when the block has ended, in the main thread: within it a child is started.

    They are not blocked, for the child would be born so.
    """
    if not _watched or threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    numbers = (signal.SIGALRM, *_watched)
    for number in numbers:
        signal.signal(number, lambda number, frame: arrived.append(number))
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, _raise)
    for number in arrived:
        signal.raise_signal(number)


def _raise(number: int, frame: Any) -> None:
    global _since
    now = time.monotonic()
    if _decided or (number != signal.SIGALRM and _since is not None):
        return
    if _since is None:
        _since = now
    module = _module(frame)
    ours = module.startswith(OURS) and module != __name__
    caller = None if ours else _gets_a_record(frame)
    if caller is not None:
        _raise_in(caller)
    elif not ours and (module == __name__ or now - _since < GRACE):
        signal.setitimer(signal.ITIMER_REAL, LOOK)
    else:
        raise KeyboardInterrupt


def _module(frame: Any) -> str:
    return str(frame.f_globals.get("__name__")) if frame else ""


def _gets_a_record(frame: Any) -> Any:
    """The frame for which a compiled function makes a record at present, None if none does."""
    making = False
    while frame:
        here = _module(frame).startswith(MAKING_RECORDS)
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
    if _decided:
        return
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        # Raised here it would be swallowed once more.
        signal.setitimer(signal.ITIMER_REAL, LOOK)
    elif not come():  # what Ctrl-C left half made complains when it is collected
        sys.__unraisablehook__(unraisable)


def _printed(kind: type[BaseException], error: BaseException, trace: Any) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
