"""A real scheduler with two worker processes, one of which is killed: the same bits, only later."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from valve_control.parameter import ParameterError, defaults, updated
from valve_control.parameters.table import NODES
from valve_control.simulation import cluster, robustness

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
        until(told.exists, "the scheduler")
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


@pytest.mark.parametrize("command", ["study", "tune"])
def test_unreachable_cluster_is_one_sentence(run, tmp_path, command, monkeypatch):
    monkeypatch.setattr(cluster, "MEET", 0.5)
    status, _, err = run(command, "--cluster", "tcp://127.0.0.1:9")
    assert status == 2 and "--cluster tcp://127.0.0.1:9: no scheduler answers there" in err
    assert len([line for line in err.splitlines() if line.startswith("valve-control:")]) == 1
    assert "Traceback" not in err
