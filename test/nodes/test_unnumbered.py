# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A middleware that numbers no messages, such as Cyclone DDS: losses are unknown, nothing else is."""

import signal
import subprocess
import sys
from contextlib import ExitStack, contextmanager

from bench import spin_until
from std_msgs.msg import Float64

from valve_control.nodes.adapter import UNKNOWN

# The node as it is, with the number that rmw gives where there is none.
NODE = """
import sys
from valve_control.nodes import adapter

def unnumbered(take):
    def one(self):
        taken = take(self)
        if taken is not None:
            taken[1]["publication_sequence_number"] = 2**64 - 1
        return taken
    return one

for kind in (adapter.PolledSubscription, adapter.NumberSubscription):
    kind.one = unnumbered(kind.one)
from valve_control.nodes.{} import main
sys.exit(main())
"""


@contextmanager
def node(name, log, *settings):
    arguments = [word for setting in settings for word in ("-p", setting)]
    with log.open("wb") as output:
        child = subprocess.Popen(
            [sys.executable, "-c", NODE.format(name), "--ros-args", *arguments],
            stdout=output, stderr=output, start_new_session=True,
        )  # fmt: skip
        try:
            yield child
        finally:
            child.terminate()
            try:
                child.wait(20.0)
            finally:
                child.kill()


def test_a_cascade_runs_and_says_once_that_losses_are_unknown(ros, tmp_path):
    slow = "sample_period:=0.004"
    settings = {
        "recorder": [f"bag:={tmp_path / 'bag'}", "storage:=sqlite3"],
        "command_source": [slow, "trigger:=valve_voltage", "scenario:=sine", "start:=0.0", "delay:=0.0"],
        "controller": [slow],
        "valve_simulator": [slow],
    }
    logs = {name: tmp_path / f"{name}.log" for name in settings}
    commands = []
    ros.create_subscription(Float64, "spool_command", commands.append, 10)
    with ExitStack() as stack:
        children = {
            name: stack.enter_context(node(name, logs[name], *words)) for name, words in settings.items()
        }
        spin_until(ros, lambda: any(command.data > 0.5 for command in commands), "commands by arrival")
        spin_until(ros, lambda: "records /valve_voltage " in logs["recorder"].read_text(), "the topic")
        children["recorder"].send_signal(signal.SIGINT)
        assert children["recorder"].wait(20.0) == 0, logs["recorder"].read_text()
    assert "valve_voltage: " in logs["recorder"].read_text()
    assert logs["controller"].read_text().count(UNKNOWN) == 1
    assert "controlling" in logs["controller"].read_text()
