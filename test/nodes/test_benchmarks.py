# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Benchmarks that are stopped."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.campaign
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_benchmark_says_that_and_leaves_no_node(tmp_path, number):
    """The middleware ended first: "missed: loop: the given context is not valid"."""
    child = subprocess.Popen(
        [sys.executable, "-m", "benchmarks", "--only", "loop", "--out", tmp_path],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, bufsize=0,
    )  # fmt: skip
    try:
        ended(child, number)
    finally:
        child.kill()
        child.communicate()


def ended(child, number):
    seen = ""
    limit = time.monotonic() + 120.0
    while "latency:" not in seen:
        assert time.monotonic() < limit and child.poll() is None, seen
        if select.select([child.stderr], [], [], 1.0)[0]:
            seen += os.read(child.stderr.fileno(), 1000).decode(errors="replace")
    group = [int(p) for p in Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()]
    child.send_signal(number)
    _, err = child.communicate(timeout=30)
    assert child.returncode == 130 and err.splitlines()[-1] == "stopped; no node is left running"
    assert len(group) > 5 and not any(Path(f"/proc/{pid}").exists() for pid in group)
