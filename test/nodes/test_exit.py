# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Ends of nodes and tools: quiet, with the status that was decided, and with no thread left."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import sizes
from bench import PROGRAMS, spin_until
from std_msgs.msg import Float64

from valve_control.nodes import NODES, loop
from valve_control.nodes.controller_node import Controller

THREADS_LEFT = """
import json, os
from valve_control.nodes import command_source, controller, loop, valve_simulator
loop._loop = lambda *parts: None  # the life between start and end
for node in (controller, valve_simulator, command_source):
    status = node.main()
    threads = [open(f"/proc/self/task/{t}/comm").read().strip() for t in os.listdir("/proc/self/task")]
    print(json.dumps([status, threads]))
"""


ROOT = Path(__file__).resolve().parents[2]
# Without which a node does not begin.
NEEDED = {
    "axis_controller": ("--ros-args", "-p", "machine:=bench"),
    "valve_driver": ("--ros-args", "-p", "autostart:=false"),
}


def start(name, *arguments, cwd=None):
    arguments = (*arguments, *NEEDED.get(name, ()))
    return subprocess.Popen(
        [sys.executable, "-m", PROGRAMS[name], *arguments],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def mask(child, kind):
    """Whether SIGTERM is in a mask (SigCgt: caught, SigIgn: ignored) of a process that lives."""
    with open(f"/proc/{child.pid}/status", encoding="ascii") as status:
        for line in status:
            if line.startswith(kind):
                return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False  # it has ended


def until(condition, what):
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.0005)


def test_no_thread_of_the_middleware_outlives_a_node():
    """Such a thread calls into what the exit has taken apart: "pure virtual method called"."""
    done = subprocess.run(
        [sys.executable, "-c", THREADS_LEFT],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    ends = [json.loads(line) for line in done.stdout.splitlines()]
    assert [status for status, _ in ends] == [0, 0, 0]
    for _, threads in ends:
        # The watchdog of the shared memory belongs to the library and stays with every rclpy program.
        assert [name for name in threads if name.startswith("dds.")] in ([], ["dds.shm.wdog"])


QUICK = (
    ("valve_simulator", signal.SIGINT),
    ("controller", signal.SIGTERM),
    ("command_source", signal.SIGTERM),
    ("recorder", signal.SIGINT),
    ("manifold", signal.SIGTERM),
    ("valve_driver", signal.SIGINT),
    ("axis_simulator", signal.SIGTERM),
    ("axis_controller", signal.SIGINT),
)


@pytest.mark.parametrize(
    ("node", "number"),
    [
        pytest.param(node, number, marks=() if (node, number) in QUICK else pytest.mark.campaign)
        for node in NODES
        for number in (signal.SIGINT, signal.SIGTERM)
    ],
)
def test_more_signals_during_the_exit_change_nothing(tmp_path, node, number):
    arguments = ["--ros-args", "-p", f"bag:={tmp_path / 'bag'}"] if node == "recorder" else []
    with start(node, *arguments) as child:
        for line in child.stderr:
            if "[INFO]" in line or node == "manifold":
                break
        while child.poll() is None:
            child.send_signal(number)
            time.sleep(0.002)
        assert child.returncode == 0
        assert "Traceback" not in child.stderr.read()


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("controller", 2),
        ("demo", 2),
        *(pytest.param(name, sizes.INTERRUPTED_IMPORTS, marks=pytest.mark.campaign) for name in PROGRAMS),
    ],
)
def test_ctrl_c_during_the_imports_is_quiet(name, count, tmp_path):
    moments = random.Random(name)
    for _ in range(count):
        with start(name, *(["--out", str(tmp_path)] if name not in NODES else []), cwd=tmp_path) as child:
            until(lambda c=child: mask(c, "SigCgt"), f"{name} did not begin")
            time.sleep(moments.uniform(0.0, 0.6))
            child.send_signal(signal.SIGINT)
            out, err = child.communicate(timeout=30.0)
        assert child.returncode == (0 if name in NODES else 130), (child.returncode, err)
        assert "Traceback" not in err, err


STOPPED = """
import os, signal, sys
from pathlib import Path
from research.campaigns.processes import run_tool
__name__ = "valve_control.program"

def below_a_text():
    eval("os.kill(os.getpid(), signal.SIGINT)")

def in_a_compiled_module():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        raise ImportError("initialization failed")

class Bar:
    def __init__(self):
        os.kill(os.getpid(), signal.SIGINT)
        self.shown = True

    def __del__(self):
        assert self.shown

def in_a_constructor():
    Bar()

def at_a_collection():
    import gc  # the exception is swallowed there
    gc.callbacks.append(lambda phase, info: os.kill(os.getpid(), signal.SIGTERM))
    gc.collect()
    while True:
        pass

for work in (below_a_text, in_a_compiled_module, in_a_constructor, at_a_collection):
    child = os.fork()
    if child == 0:
        sys.exit(run_tool("it", Path(sys.argv[1]), work))
    print(work.__name__, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def test_ctrl_c_gives_the_status_wherever_it_comes(tmp_path):
    """Python ends a process by SIGINT whose KeyboardInterrupt was raised below an evaluated text.

    A shell shows 130 for it. An import of a compiled module turns the exception into another one, and an
    object whose constructor did not come to its end complains when it is collected.
    """
    done = subprocess.run(
        [sys.executable, "-c", STOPPED, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done
    works = [line.split() for line in done.stdout.splitlines()]
    assert len(works) == 4 and {status for _, status in works} <= {"130", "-2"}, done


class Failing(loop.Worker):
    """A node whose middleware is gone at its end."""

    def finish(self):
        raise OSError("no space left\nfor the message")


def test_a_node_that_fails_at_its_end_does_not_keep_the_others_from_their_last_voltage(ros, capsys):
    heard = []
    ros.create_subscription(Float64, "valve_voltage", lambda m: heard.append(m.data), 10)
    failing = Failing("failing")
    valve = Controller(alone=False)
    try:
        spin_until(ros, lambda: valve._voltages.get_subscription_count() == 1, "the subscription")
        assert not loop._finished([failing, valve])
        assert capsys.readouterr().err == "valve_control: failing: no space left\n"
        spin_until(ros, lambda: heard, "the last voltage")
        assert heard == [0.0] and loop._finished([valve])
    finally:
        failing.destroy_node()
        valve.destroy_node()
