# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the kernel refuses is said in one sentence each, and nothing else changes."""

import os
import resource
import threading
from contextlib import contextmanager

from valve_control.nodes import realtime
from valve_control.nodes.realtime import Request

NOBODY = 65534


@contextmanager
def unprivileged():
    """Without root's capabilities, and with limits of 0 for locked memory and priority."""
    user = os.geteuid()
    limits = {kind: resource.getrlimit(kind) for kind in (resource.RLIMIT_MEMLOCK, resource.RLIMIT_RTPRIO)}
    for kind, (_, hard) in limits.items():
        resource.setrlimit(kind, (0, hard))
    if user == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(user)
        for kind, limit in limits.items():
            resource.setrlimit(kind, limit)


def test_each_refusal_of_the_kernel_is_a_sentence_with_the_limit_to_raise():
    before, said = realtime.obtained(), []
    with unprivileged():
        realtime.obtain(Request(True, 20, ()), said.append)
        realtime.obtain(Request(False, 20, ()), said.append)
    memory, priority, alone = said
    assert alone == priority
    assert memory.startswith("realtime.lock_memory: not locked, ") and "ulimit -l" in memory
    assert priority.startswith("realtime.priority: 20 not obtained, ") and "ulimit -r" in priority
    assert realtime.obtained() == before


def test_a_thread_that_has_ended_meanwhile_does_not_keep_the_others_from_theirs():
    asked, ended = [], 1 << 30  # beyond Linux's largest thread number, 1 << 22
    threads = [ended, threading.get_native_id()]

    def ask(thread):
        os.sched_setaffinity(thread, os.sched_getaffinity(thread))
        asked.append(thread)

    realtime.for_each(threads, ask)
    assert asked == threads[1:]
