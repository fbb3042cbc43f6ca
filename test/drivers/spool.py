# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated valve that stands behind a simulated device, and the processes that these devices are."""

import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import valve
from valve_control.parameter import defaults, updated

LIMIT = 20.0  # s


class Spool:
    """A valve, one sample at a time."""

    def __init__(self, period=0.001):
        self.p = build.valve_params(updated(VALVE, defaults(VALVE), {"sample_period": period}))
        self.s = valve.initial(self.p)

    def sample(self, volts):
        """Reading [V] at this sample, after which ``volts`` act for one period."""
        reading = valve.read(self.p, self.s, 0.0)
        self.s = valve.step(self.p, self.s, volts)
        return reading


@contextmanager
def device(module, *words):
    """Process of a simulated device: what it says first, and its standard input for orders."""
    child = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name(f"{module}.py")), *words],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
    )  # fmt: skip
    try:
        yield Device(child)
    finally:
        child.kill()
        child.wait()


class Device:
    def __init__(self, child):
        self.child = child
        self.address = child.stdout.readline().strip()
        assert self.address, "the simulated device did not start"

    def order(self, text):
        """Give an order; returns the device's answer."""
        self.child.stdin.write(text + "\n")
        return self.child.stdout.readline().strip()


def until(condition, what, limit=LIMIT):
    end = time.monotonic() + limit
    while not (found := condition()):
        assert time.monotonic() < end, f"{what} not within {limit} s"
    return found
