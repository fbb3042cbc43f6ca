# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lets a search give way to control loops on the same host."""

import os
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

LOOPS = ("controller", "valve_driver", "valve_simulator", "manifold")  # nodes that a busy core delays
T = TypeVar("T")


def yield_cores() -> None:
    """Let this process and all that it starts run only while no other wants the core.

    With autogroups (sched(7)) Linux shares the cores between sessions before it looks at their processes. The
    leader of a session therefore lowers the session too.
    """
    _yield_thread()
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            Path("/proc/self/autogroup").write_text("19", encoding="ascii")


def _yield_thread() -> None:
    """``yield_cores`` of this thread and all that it starts."""
    try:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    except (AttributeError, OSError):  # no Linux, or not allowed
        os.nice(19)


def spare_cores() -> int:
    """Number of cores that leaves one to a loop, where there are two."""
    return max(1, (os.cpu_count() or 1) - 1)


def loop_runs() -> bool:
    """Whether a control loop of this package runs on this host, as far as /proc shows it."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = path.read_bytes().decode(errors="replace").split("\0")
            if any(word.rpartition("/")[2].removeprefix("valve_control.nodes.") in LOOPS for word in words):
                return True
    return False


def in_background(work: Callable[[Callable[..., None]], T], told: Callable[..., None]) -> T:
    """Return what ``work`` returns, computed in a thread that yields the cores.

    ``work`` gets a function that reports progress; ``told`` is called with each report in the thread of the
    caller. An exception of ``told``, or a signal, is raised here at once. Raises what ``work`` raises.
    """
    reports: queue.SimpleQueue[tuple[object, ...] | None] = queue.SimpleQueue()
    future: Future[T] = Future()

    def run() -> None:
        _yield_thread()
        try:
            future.set_result(work(lambda *progress: reports.put(progress)))
        except BaseException as error:
            future.set_exception(error)
        reports.put(None)

    threading.Thread(target=run, name="search", daemon=True).start()
    while (progress := reports.get()) is not None:
        told(*progress)
    return future.result()
