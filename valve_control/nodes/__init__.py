# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Connects laws and valve to ROS 2 as nodes; the only part of the package that imports ROS.

A reading goes through loop.py, controller_node.py, supervision/supervisor.py, control_step.py and the law.
"""

import os
import signal
import sys
from typing import Any

from valve_control.nodes.transport import use_own_profile

# Matrices of a few rows need no threads. Those of OpenBLAS wait by spinning, and under SCHED_FIFO on one CPU
# the thread that they wait for would never run. It has to be said before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

use_own_profile(os.environ)

NODES = (
    "controller",
    "valve_simulator",
    "valve_driver",
    "command_source",
    "manifold",
    "recorder",
    "axis_simulator",
    "axis_controller",
    "dashboard",
)


def program() -> str:
    """Name of the program that this process was started as, "" if it only imports one."""
    if sys.argv[:1] != ["-m"]:
        return os.path.basename(sys.argv[0]) if sys.argv else ""
    words = sys.orig_argv
    return words[words.index("-m") + 1].rpartition(".")[2] if "-m" in words else ""


def leave_quietly(status: int) -> None:
    """End the process at once on SIGINT and SIGTERM, while there is nothing yet to be ended in order."""

    def leave(number: int, frame: Any) -> None:
        os._exit(status)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, leave)


# The imports of a node take a second or more, in which Ctrl-C would give a traceback.
if program() in NODES:
    leave_quietly(0)
