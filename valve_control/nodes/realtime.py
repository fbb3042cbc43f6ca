# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Asks Linux for what keeps samples in time: memory lock, real-time scheduler, CPU affinity."""

import contextlib
import ctypes
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from valve_control import parameter
from valve_control.parameter import ParameterError, Values, number

MCL_CURRENT, MCL_FUTURE = 1, 2
POLICIES = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}


class Request(NamedTuple):
    """What the parameters ask the kernel for."""

    lock_memory: bool
    priority: int  # 0: leave the scheduler
    cpus: tuple[int, ...]  # empty: leave them


UNCHANGED = Request(False, 0, ())


def request(values: Values) -> Request:
    """Request from a node's parameter values, which may have none. Raises ParameterError."""
    if "realtime.cpus" not in values:
        return UNCHANGED
    text = parameter.word(values, "realtime.cpus").strip()
    try:
        cpus = tuple(int(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise ParameterError(f"realtime.cpus is '{text}'; it must be CPU numbers such as 2 or 2,3") from None
    missing = [cpu for cpu in cpus if not 0 <= cpu < (os.cpu_count() or 1)]
    if missing:
        raise ParameterError(
            f"realtime.cpus names CPU {missing[0]}; this machine has 0 to {(os.cpu_count() or 1) - 1}"
        )
    return Request(values["realtime.lock_memory"] is True, int(number(values, "realtime.priority")), cpus)


def for_each(threads: Iterable[int], ask: Callable[[int], None]) -> None:
    """Call ``ask`` with each thread; one that has ended meanwhile needs nothing. Raises OSError."""
    for thread in threads:
        with contextlib.suppress(ProcessLookupError):
            ask(thread)


def obtain(wanted: Request, warn: Callable[[str], None]) -> None:
    """Ask the kernel for ``wanted``, for all threads of the process; calls ``warn`` for each refusal."""
    threads = [int(entry.name) for entry in Path("/proc/self/task").iterdir()]
    if wanted.lock_memory:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
            reason = os.strerror(ctypes.get_errno())
            warn(f"realtime.lock_memory: not locked, {reason}; the limit is 'ulimit -l' (memlock)")
    param = os.sched_param(wanted.priority)
    for name, value, hint, ask in (
        ("priority", wanted.priority, "; the limit is 'ulimit -r' (rtprio)",
         lambda thread: os.sched_setscheduler(thread, os.SCHED_FIFO, param)),
        ("cpus", wanted.cpus, "", lambda thread: os.sched_setaffinity(thread, wanted.cpus)),
    ):  # fmt: skip
        if value:
            try:
                for_each(threads, ask)
            except OSError as error:
                warn(f"realtime.{name}: {value} not obtained, {error.strerror}{hint}")


def obtained() -> dict[str, str]:
    """Scheduler, CPUs and locked memory that this process really has."""
    policy = os.sched_getscheduler(0)
    priority = os.sched_getparam(0).sched_priority
    status = Path("/proc/self/status").read_text(encoding="ascii")
    locked = next(line.split()[1] for line in status.splitlines() if line.startswith("VmLck"))
    return {
        "scheduler": POLICIES.get(policy, str(policy)) + (f" {priority}" if priority else ""),
        "cpus": ",".join(map(str, sorted(os.sched_getaffinity(0)))),
        "locked_memory_kB": locked,
    }
