# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes that are forked from one that has imported all of them.

Such a node begins 0.5 s earlier than by `python -m`, without its imports. It ends by os._exit, without the
exit of the interpreter, and the modules of all nodes are loaded. The tests of exits (test_exit.py), of
installed programs and of the tools (`run_tool`) start nodes as users do.
"""

import multiprocessing
import os
import signal
import subprocess
import sys
from importlib import import_module

from valve_control import nodes

MODULES = {name: f"valve_control.nodes.{name}" for name in nodes.NODES}
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(["pytest", *MODULES.values()])


class Child:
    """A forked process, with the methods of subprocess.Popen."""

    def __init__(self, node, words, log, folder="."):
        given = (node, words, str(log), os.path.abspath(folder), dict(os.environ))
        self._process = _context.Process(target=_run, args=given)
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self):
        return self._process.exitcode

    poll = returncode.fget

    def wait(self, timeout=None):
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout)
        return self.returncode

    def send_signal(self, number):
        if self.returncode is None:
            os.kill(self.pid, number)

    def terminate(self):
        self.send_signal(signal.SIGTERM)

    def kill(self):
        self.send_signal(signal.SIGKILL)


def start(node, arguments, output):
    """As ``processes.start``."""
    return Child(node, ["--ros-args", *arguments], output.name)


def _run(node, words, log, folder, environment):
    nodes.leave_quietly(0)
    os.setsid()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    anew = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    for path, flags, numbers in ((os.devnull, os.O_RDONLY, (0,)), (log, anew, (1, 2))):
        opened = os.open(path, flags)
        for number in numbers:
            os.dup2(opened, number)
        os.close(opened)
    module = import_module(MODULES[node])
    sys.argv = [module.__file__, *words]
    sys.exit(module.main())
