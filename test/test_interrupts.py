# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C at any moment of the command: status 130, no traceback, no process left."""

import contextlib
import os
import pathlib
import random
import signal
import subprocess
import sys
import time

import pytest
import sizes

# What a user types, with a word on standard error when the command has begun.
BEGUN = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from valve_control import cli, interrupts; "
    "interrupts.watch(); print('begun', file=sys.stderr, flush=True); sys.exit(cli.main())"
)


def start(*arguments, cwd):
    child = subprocess.Popen(
        [sys.executable, "-c", BEGUN, *map(str, arguments)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd,
        start_new_session=True,
    )  # fmt: skip
    assert child.stderr.readline() == "begun\n"
    return child


def living(group):
    """Process ids of the group ``group`` that have not ended (one that nobody has waited for has)."""
    found = []
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, its_group = stat.read_text().rpartition(")")[2].split()[:3]
            if int(its_group) == group and state != "Z":
                found.append(int(stat.parent.name))
    return found


def stopped(child):
    """Ctrl-C as a terminal gives it, to all processes of the command, again and again until it has ended."""
    while child.poll() is None:
        os.killpg(child.pid, signal.SIGINT)
        time.sleep(0.003)
    out, err = child.communicate(timeout=30.0)
    assert "Traceback" not in err and "KeyboardInterrupt" not in err, err
    until = time.monotonic() + 5.0
    while living(child.pid):
        assert time.monotonic() < until, f"processes {living(child.pid)} outlive the command"
        time.sleep(0.01)
    # Python itself ends by SIGINT if the exception came from below an eval; a shell shows 130 for it.
    return child.returncode if child.returncode >= 0 else 128 - child.returncode, out, err


RECORDS = """
import math, os, signal, threading
import numpy as np
from typing import NamedTuple
from valve_control import interrupts
from valve_control.control.compiling import compile_function

class Pair(NamedTuple):
    first: float
    second: float

class Pairs(NamedTuple):
    one: Pair
    two: Pair
    row: object

def work(n):
    x = 0.0
    row = np.zeros(3)
    for i in range(n):
        x += math.sin(x + i)
    return Pairs(Pair(x, 1.0), Pair(2.0, x), row)

if __name__ == "__main__":
    compiled = compile_function(work, nogil=True)
    compiled(10)
    interrupts.watch()
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        while True:
            compiled(2_000_000)
    except KeyboardInterrupt:
        print("stopped")
"""


def test_a_compiled_function_is_not_interrupted_while_it_makes_its_record(tmp_path):
    """It would end the process with a segmentation fault; its signals are delivered just then."""
    (tmp_path / "records.py").write_text(RECORDS)
    for _ in range(3):
        done = subprocess.run(
            [sys.executable, "records.py"],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
            cwd=tmp_path,
        )
        assert (done.returncode, done.stdout) == (0, "stopped\n"), done


PARTS = 4  # of the campaign, for several workers


@pytest.mark.parametrize(
    ("count", "part"),
    [
        (3, 0),
        *(
            pytest.param(sizes.INTERRUPTED_RUNS // PARTS, part, marks=pytest.mark.campaign)
            for part in range(PARTS)
        ),
    ],
)
def test_any_moment_of_a_run(tmp_path, count, part):
    moments = random.Random(100 * part + count)
    for _ in range(count):
        child = start("simulate", "--duration", "1200", "--json", "out.json", cwd=tmp_path)
        time.sleep(moments.uniform(0.0, 2.0))
        status, out, err = stopped(child)
        assert err in ("", "valve-control: simulate was stopped\n")
        assert status == 130 or (status, (tmp_path / "out.json").exists()) == (0, True)
        assert status == 0 or list(tmp_path.iterdir()) == [], err
        for path in tmp_path.iterdir():
            path.unlink()


@pytest.mark.parametrize(
    ("arguments", "longest"),
    [
        (("compare", "--duration", "300"), 2.5),
        (("identify",), 1.2),
        (("study", "--valves", "100000", "--folder", "kept"), 3.0),
    ],
    ids=lambda a: a[0] if isinstance(a, tuple) else "",
)
@pytest.mark.parametrize("count", [1, pytest.param(sizes.INTERRUPTED_COMMANDS, marks=pytest.mark.campaign)])
def test_any_moment_of_other_commands(tmp_path, arguments, longest, count):
    moments = random.Random(count)
    stati = []
    for _ in range(count):
        child = start(*arguments, cwd=tmp_path)
        time.sleep(moments.uniform(0.0, longest))
        status, _, err = stopped(child)
        assert status in (130, 0), err
        stati.append(status)
    assert stati.count(130) >= count / 3, "the command was over before Ctrl-C came"
