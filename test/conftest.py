# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import gc
import os
import sys
from pathlib import Path
from typing import NamedTuple

import domains
import pytest
from hypothesis import settings

# On this host only; nodes and their processes inherit both.
os.environ["ROS_DOMAIN_ID"] = str(domains.OWN)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
# Matrices are small: BLAS threads that wait for each other take longer. numpy reads it as it loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import changed

from valve_control.cli import main
from valve_control.control.parameters.table import VALVE
from valve_control.control.simulation import offline
from valve_control.parameter import defaults, updated

# How long an example takes depends on what else the machine does.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

REPETITIONS = 5  # of tests in a run; more fail it


def _repeated(config):
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    return len(reporter.stats.get("rerun", ())) if reporter else 0


def pytest_collection_finish(session):
    """Where no nodes are tested, rarer searches for cycles: a tenth of the CPU time, compiling above all."""
    if not any("nodes" in item.path.parts for item in session.items):
        gc.freeze()
        gc.set_threshold(50_000, 20, 100)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session):
    if _repeated(session.config) > REPETITIONS and session.exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter, config):
    if count := _repeated(config):
        text = f"{count} repetitions, at most {REPETITIONS} are allowed"
        terminalreporter.write_line(text, red=count > REPETITIONS)


ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def config():
    return ROOT / "config"


class Ran(NamedTuple):
    """A command's exit status, standard output and standard error."""

    status: int
    out: str
    err: str


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """A command of `valve-control` in this process and in ``tmp_path``: its status, output and errors."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        try:
            status = main([str(a) for a in arguments])
        except SystemExit as error:
            status = error.code
        return Ran(status, *capsys.readouterr())

    return call


@pytest.fixture
def simulate():
    """Offline run from a few changes of the defaults."""

    def run(controller, command, period=0.001, compiled=True, valve=None, **changes):
        c = changed.controller(controller=controller, sample_period=period, **changes)
        v = updated(VALVE, defaults(VALVE), {"sample_period": period, **(valve or {})})
        return offline.simulate(c, v, command, compiled)

    return run
