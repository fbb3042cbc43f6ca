"""Benchmarks that are stopped."""

import os
import signal
import subprocess
import sys
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
    seen = ""
    while "latency:" not in seen:
        seen += os.read(child.stderr.fileno(), 1000).decode()
        assert child.poll() is None, seen
    group = [int(p) for p in Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()]
    child.send_signal(number)
    _, err = child.communicate(timeout=30)
    assert child.returncode == 130 and err.splitlines()[-1] == "stopped; no node is left running"
    assert len(group) > 5 and not any(Path(f"/proc/{pid}").exists() for pid in group)
