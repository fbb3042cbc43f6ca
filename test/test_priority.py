# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A search gives way to a loop, and whoever waits for it goes on at once."""

import os
import subprocess
import sys
import threading

import pytest

from valve_control.design import priority


def policy():
    return os.sched_getscheduler(0)


def test_a_search_in_the_background_yields_the_cores_and_reports_to_its_caller():
    told, inner = [], []

    def work(report):
        report(1, 2)
        child = threading.Thread(target=lambda: inner.append(policy()))
        child.start()
        child.join()
        report(2, 2)
        return policy()

    before = policy()
    found = priority.in_background(work, lambda *done: told.append((done, threading.current_thread())))
    assert found == os.SCHED_IDLE and inner == [os.SCHED_IDLE] and policy() == before
    assert told == [((1, 2), threading.main_thread()), ((2, 2), threading.main_thread())]


def test_an_exception_of_the_caller_does_not_wait_for_the_search():
    raised = threading.Event()

    def work(report):
        report()
        assert raised.wait(60.0)

    def told():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        priority.in_background(work, told)
    raised.set()
    with pytest.raises(ValueError, match="of the search"):
        priority.in_background(lambda report: int("of the search"), print)


def test_a_loop_on_this_host_is_seen_and_has_a_core(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    assert priority.spare_cores() == 1
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert priority.spare_cores() == 1
    command = [sys.executable, "-c", "print(flush=True); input()", "/lib/valve_control/valve_driver"]
    monkeypatch.setattr(priority, "LOOPS", ("valve_driver_of_this_test",))
    assert not priority.loop_runs()
    monkeypatch.setattr(priority, "LOOPS", ("valve_driver",))
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        child.stdout.readline()  # it runs
        assert priority.loop_runs()
        child.communicate(b"\n")


def test_a_command_of_its_own_process_yields():
    script = (
        "import os; from valve_control.cli import command; "
        "command.run(['tune', '--controller', 'none'], alone=True); print(os.sched_getscheduler(0))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.split()[-1] == str(os.SCHED_IDLE), done
