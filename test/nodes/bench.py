# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the node tests share: a ROS context, service calls, and a bench that plays LVDT and upper level."""

import json
import math
import os
import subprocess
import sys
import time
from contextlib import contextmanager

import domains
import numpy as np
import rclpy
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, Float64MultiArray

from research import campaigns
from research.campaigns.processes import process
from valve_control import nodes
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import valve
from valve_control.nodes.rclpy_internals import WaitSet
from valve_control.parameter import defaults

LIMIT = 20.0  # s
AGAIN = 0.1  # s
PROGRAMS = {
    **{name: f"valve_control.nodes.{name}" for name in nodes.NODES},
    **{name: f"research.campaigns.{name}" for name in campaigns.TOOLS},
}  # what is started as a process → its module
HOLD = 2000  # samples; the bench is slower than the clock


def spin_until(node, condition, what, limit=LIMIT, again=lambda: None):
    """Spin until ``condition`` holds; ``again`` is called at once and every ``AGAIN``."""
    due = time.monotonic()
    end = due + limit
    while not condition():
        now = time.monotonic()
        assert now < end, f"{what} not within {limit} s"
        if now >= due:
            due = now + AGAIN
            again()
        rclpy.spin_once(node, timeout_sec=0.05)


def wait_for_message(node, subscription):
    """Wait until a message has come to the polled ``subscription`` of ``node``, without taking it."""
    waiting = WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)
    with subscription.handle:
        waiting.add_subscription(subscription.handle)
        waiting.wait(round(LIMIT * 1e9))
        assert waiting.is_ready("subscription", 0), "no message has come"


def introduce(node, target):
    """Until the node ``target`` has discovered all clients, publishers and subscriptions that ``node`` has.

    A process discovers those of another one in the order of their creation. So a question of a client that is
    made last shows it by its answer. It changes nothing and is asked again, since a server that has not yet
    discovered its client does not hear it before the next heartbeat, up to 3 s later.
    """
    client = node.create_client(GetParameters, f"{target}/get_parameters")
    spin_until(node, client.service_is_ready, target)
    futures = []
    spin_until(
        node,
        lambda: any(future.done() for future in futures),
        f"answer of {target}",
        again=lambda: futures.append(client.call_async(GetParameters.Request())),
    )
    node.destroy_client(client)


def call(node, service, name, request):
    """One service call, sent once, to a server that has discovered its client."""
    client = node.create_client(service, name)
    spin_until(node, client.service_is_ready, name)
    introduce(node, name.rpartition("/")[0])
    future = client.call_async(request)
    spin_until(node, future.done, f"answer from {name}")
    node.destroy_client(client)
    return future.result()


def set_parameters(node, target="controller", **values):
    """All of ``values`` or none; ``a__b`` stands for ``a.b``."""
    request = SetParametersAtomically.Request(
        parameters=[
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
    )
    return call(node, SetParametersAtomically, f"/{target}/set_parameters_atomically", request).result


def get_double(node, name, target="controller"):
    got = call(node, GetParameters, f"/{target}/get_parameters", GetParameters.Request(names=[name]))
    return got.values[0].double_value


class Bench:
    """Plays LVDT and upper level for a controller, one sample at a time."""

    def __init__(self, node):
        self.node = node
        self.voltages = []
        self.states = []
        self.lvdt = node.create_publisher(Float64, "spool_position", 10)
        self.command = node.create_publisher(Float64, "spool_command", 1)
        self.voltage = node.create_subscription(
            Float64, "valve_voltage", lambda m: self.voltages.append(m.data), 10
        )
        node.create_subscription(Float64MultiArray, "/controller/state", self.states.append, 10)

    def connect(self):
        spin_until(
            self.node,
            lambda: (
                self.lvdt.get_subscription_count() == 1
                and self.command.get_subscription_count() == 1
                and self.voltage.get_publisher_count() == 1
            ),
            "controller",
        )
        introduce(self.node, "/controller")  # from here on each reading has its answer
        knocks = []

        def knock():
            knocks.append(self.lvdt.publish(Float64(data=0.0)))

        spin_until(self.node, lambda: self.voltages, "first voltage", again=knock)
        spin_until(self.node, lambda: len(self.voltages) >= len(knocks), "a voltage for each reading")

    def settle(self):
        """Until 0.5 s pass without a voltage."""
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            count = len(self.voltages)
            rclpy.spin_once(self.node, timeout_sec=0.05)
            if len(self.voltages) != count:
                end = time.monotonic() + 0.5

    def sample(self, reading):
        count = len(self.voltages)
        self.reading = reading
        self.lvdt.publish(Float64(data=reading))
        spin_until(self.node, lambda: len(self.voltages) > count, "voltage")
        return self.voltages[-1]

    def state(self):
        """The terms of ~/state by name, of the last reading, which no other one equals."""

        def terms():
            last = self.states[-1]
            return dict(zip((entry.label for entry in last.layout.dim), last.data, strict=True))

        spin_until(self.node, lambda: self.states and terms()["measurement"] == self.reading, "state")
        return terms()


class Motion:
    """A bench whose readings come from a simulated valve on a 1 Hz sine of 2 V."""

    def __init__(self, node, noise=0.002):
        self.bench = Bench(node)
        self.p = build.valve_params({**defaults(VALVE), "lvdt.noise": noise})
        self.s = valve.initial(self.p)
        self.random = np.random.default_rng(1)
        self.voltages = []

    def move(self, samples):
        for _ in range(samples):
            t = len(self.voltages) * self.p.period
            self.bench.command.publish(Float64(data=2.0 * math.sin(2.0 * math.pi * t)))
            reading = valve.read(self.p, self.s, float(self.random.standard_normal()))
            self.voltages.append(self.bench.sample(reading))
            self.s = valve.step(self.p, self.s, self.voltages[-1])


@contextmanager
def controller(tmp_path, *arguments):
    """A controller that takes its time: the bench makes its samples one by one, not on the clock."""
    slow = [
        f"lvdt.hold_samples:={HOLD}",
        "lvdt.frozen_samples:=0",
        "command_timeout:=0.0",
        "lvdt.period_limit:=1000.0",
        "state_decimation:=1",
    ]
    given = " ".join(arguments)
    settings = [word for s in slow if s.split(":=")[0] not in given for word in ("-p", s)]
    with process("controller", [*settings, *arguments], tmp_path / "c.log") as child:
        yield child


def beside():
    """The environment of processes in another domain than this test's own."""
    return {**os.environ, "ROS_DOMAIN_ID": str(domains.BESIDE)}


def run_tool(tool, folder, *arguments, timeout=900):
    """Run `demo`, `faults` or `lockstep` as a user does, in a domain of its own; what it wrote."""
    done = subprocess.run(
        [sys.executable, "-m", PROGRAMS[tool], "--out", str(folder), *arguments],
        capture_output=True,
        text=True,
        timeout=timeout,
        env=beside(),
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads((folder / f"{tool}.json").read_text())
