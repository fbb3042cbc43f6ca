# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A real scheduler with two worker processes, one of which is killed: the same bits, only later."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import cluster, robustness
from valve_control.design.tuning.kept import OUTCOMES
from valve_control.parameter import ParameterError, defaults, updated

LIMIT = 120.0  # s


def until(condition, what):
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, f"{what} not within {LIMIT} s"
        time.sleep(0.02)


@contextmanager
def processes(tmp_path, workers=2):
    """A scheduler on this host and its workers; gives its address and their processes, its own last."""
    told = tmp_path / "scheduler.json"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parent)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    common = ["--no-dashboard", "--scheduler-file", str(told)]
    started = [
        subprocess.Popen(
            [
                sys.executable,
                "-m",
                "distributed.cli.dask_scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                "0",
                *common,
            ],
            **quiet,
        )
    ]
    try:
        until(lambda: told.exists() and told.read_text().endswith("\n}"), "the scheduler")
        address = json.loads(told.read_text())["address"]
        for i in range(workers):
            folder = ["--local-directory", str(tmp_path / f"worker{i}"), "--name", str(i)]
            started.append(
                subprocess.Popen(
                    [
                        sys.executable, "-m", "distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1",
                        "--host", "127.0.0.1", *folder, *common,
                    ],
                    **quiet,
                )
            )  # fmt: skip
        if workers:
            with cluster.connected(address) as there:
                until(lambda: there.slots == workers, "workers")
        yield address, [*started[1:], started[0]]
    finally:
        for process in started:
            process.kill()
            process.wait()


def study(valves):
    settings = {node: defaults(NODES[node]) for node in ("controller", "valve_simulator", "command_source")}
    settings["controller"] = updated(NODES["controller"], settings["controller"], {"controller": "pid"})
    settings["command_source"] = updated(
        NODES["command_source"], settings["command_source"], {"duration": 2.0}
    )
    return robustness.Study(settings, valves, 1)


def slowly(number):
    """Work that takes long enough for its worker to be killed."""
    time.sleep(0.3)
    return number * number, os.getpid()


def refused(number):
    raise ParameterError(f"{number} cannot be")


@pytest.mark.campaign
def test_study_and_lost_worker(tmp_path, monkeypatch):
    """Chunks of 32 valves on two workers, one of them killed after the first chunk."""
    monkeypatch.setattr(robustness, "CHUNK", 32)
    chosen = study(256)
    here = robustness.run(chosen, tmp_path / "here", lambda done: None, 1)
    with processes(tmp_path) as (address, workers), cluster.connected(address) as there:

        def told(done):
            if done >= 32 and workers[0].poll() is None:
                workers[0].send_signal(signal.SIGKILL)

        found = robustness.run(chosen, tmp_path / "there", told, None, there)
        assert workers[0].poll() is not None and workers[1].poll() is None
    for mine, other in zip(here.results, found.results, strict=True):
        assert np.array_equal(mine, other, equal_nan=True)
    for path in (tmp_path / "here").glob("valves_*.npz"):
        assert (tmp_path / "there" / path.name).read_bytes() == path.read_bytes()


def test_parts_of_a_killed_worker_are_done_by_the_other(tmp_path):
    with processes(tmp_path) as (address, workers), cluster.connected(address) as there:
        found = {}
        for i, (square, process) in there.completed(slowly, [(n,) for n in range(12)]):
            found[i] = square
            if len(found) == 2:
                next(w for w in workers if w.pid == process).send_signal(signal.SIGKILL)
        assert found == {n: n * n for n in range(12)}
        with pytest.raises(ParameterError, match="7 cannot be"):
            list(there.completed(refused, [(7,)]))


def test_without_any_worker_it_is_done_here(tmp_path):
    with processes(tmp_path, workers=0) as (address, _), cluster.connected(address) as there:
        there._alone = 0.3
        assert dict(there.completed(slowly, [(3,), (4,)])) == {0: (9, os.getpid()), 1: (16, os.getpid())}
        assert there.lost == 2


def test_a_scheduler_that_is_lost_is_one_sentence(tmp_path):
    with processes(tmp_path, workers=1) as (address, started), cluster.connected(address) as there:
        threading.Timer(1.0, started[-1].kill).start()
        with pytest.raises(ParameterError, match=f"the cluster {address} is lost"):
            list(there.completed(slowly, [(n,) for n in range(1000)]))


@pytest.mark.campaign
def test_tune_on_a_cluster_gives_the_same_bits(run, tmp_path):
    few = ["--controller", "pid", "--alone", "--valves", "3", "--unseen", "4", "--budget", "60", "--json"]
    few = ["--duration", "2.0", "--max-chatter", "0.6", *few]
    status, _, err = run("tune", *few, "here.json", "--threads", "1")
    with processes(tmp_path) as (address, workers):
        killer = threading.Timer(3.0, workers[0].kill)
        killer.start()
        there, _, err = run("tune", *few, "there.json", "--cluster", address)
        killer.cancel()
    assert there == status, err
    assert (tmp_path / "there.json").read_text() == (tmp_path / "here.json").read_text()


# What a user types, with a word on standard error when the command has begun.
BEGUN = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from valve_control import cli, interrupts; "
    "from valve_control.design.tuning import kept; kept.EVERY = 0.0; "
    "interrupts.watch(); sys.exit(cli.main())"
)


def stopped_by_ctrl_c(arguments, cwd, parts):
    """``tune`` that gets SIGINT when it has kept something; status and what it said."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    child = subprocess.Popen(
        [sys.executable, "-c", BEGUN, "tune", *arguments],
        cwd=cwd, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment, start_new_session=True,
    )  # fmt: skip
    try:
        kept = cwd / "kept" / OUTCOMES

        def enough():
            with suppress(OSError):
                return child.poll() is not None or kept.stat().st_size > parts
            return child.poll() is not None

        until(enough, "what is kept")
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=LIMIT)
    finally:
        child.kill()
        child.wait()
    return child.returncode, err


@pytest.mark.campaign
def test_a_stopped_tune_goes_on_with_the_same_bits(run, tmp_path):
    """Stopped on a cluster, one of whose workers is killed; once more on threads; on a cluster to its end."""
    few = ["--controller", "pid", "--alone", "--valves", "3", "--unseen", "4", "--budget", "400"]
    few += ["--duration", "2.0", "--max-chatter", "0.6", "--json"]
    status, _, err = run("tune", *few, "whole.json", "--threads", "1")
    assert status in (0, 1), err
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
    few += ["parts.json", "--folder", "kept"]
    with processes(tmp_path) as (address, workers):
        killer = threading.Timer(1.0, workers[0].kill)
        killer.start()
        left, told = stopped_by_ctrl_c([*few, "--cluster", address], tmp_path, 20_000)
        killer.cancel()
        assert left == 130 and "Traceback" not in told, told
        assert "sets of gains are in kept; the same command goes on" in told
        assert not (tmp_path / "parts.json").exists()
        before = (tmp_path / "kept" / OUTCOMES).stat().st_size
        left, told = stopped_by_ctrl_c([*few, "--threads", "2"], tmp_path, before + 10_000)
        assert left == 130 and "sets of gains were tried already" in told, told
        another, _, err = run("tune", *few, "--seed", "2")
        assert another == 2 and "kept holds a search that was stopped, with other parameters" in err
        assert len([line for line in err.splitlines() if line.startswith("valve-control:")]) == 1
        again, _, err = run("tune", *few, "--cluster", address)
    assert again == status and "sets of gains were tried already" in err, err
    assert (tmp_path / "parts.json").read_bytes() == (tmp_path / "whole.json").read_bytes()
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize(("command", "address"), [("study", "tcp"), ("tune", "tcp"), ("study", "tls")])
def test_unreachable_cluster_is_one_sentence(run, tmp_path, command, address, monkeypatch):
    monkeypatch.setattr(cluster, "MEET", 0.5)
    address += "://127.0.0.1:9"
    status, _, err = run(command, "--cluster", address, "--json", "-")
    assert status == 2 and f"--cluster {address}: no scheduler answers there" in err
    assert len([line for line in err.splitlines() if line.startswith("valve-control:")]) == 1
    assert "Traceback" not in err
