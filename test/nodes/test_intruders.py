# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A second controller on one valve, and an LVDT of another rate, over real DDS."""

import pytest
from bench import controller, spin_until
from diagnostic_msgs.msg import DiagnosticArray

from valve_control.nodes.harness.processes import process


class Ear:
    """What each node says in /diagnostics."""

    def __init__(self, ros):
        self.ros = ros
        self.said = {}
        ros.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def _take(self, message):
        for status in message.status:
            self.said[status.name] = status.message

    def hear(self, name, word):
        spin_until(self.ros, lambda: word in self.said.get(name, ""), f"'{word}' of {name}")

    def hear_no_more(self, name, word):
        spin_until(self.ros, lambda: word not in self.said.get(name, word), f"no '{word}' of {name}")


def test_two_controllers_on_one_valve_are_reported_by_both_and_by_the_simulator(ros, tmp_path):
    ear = Ear(ros)
    with process("valve_simulator", [], tmp_path / "valve.log"), controller(tmp_path):
        ear.hear("controller", "no command yet")
        other = process("controller", ["-r", "__node:=other"], tmp_path / "other.log")
        with other:
            for node in ("controller", "other", "valve_simulator"):
                ear.hear(node, "2 publishers on valve_voltage")
        for node in ("controller", "valve_simulator"):
            ear.hear_no_more(node, "2 publishers on valve_voltage")
    for log in ("c.log", "valve.log"):
        assert "2 publishers on valve_voltage" in (tmp_path / log).read_text()


@pytest.mark.parametrize(
    ("period", "word"),
    [pytest.param(0.0095, "", marks=pytest.mark.campaign), (0.005, ": more than 15% off, not controlled")],
)
def test_readings_of_another_rate_are_reported_and_beyond_the_limit_not_controlled(
    ros, tmp_path, period, word
):
    """Slow ones, so that a loaded machine keeps up."""
    ear = Ear(ros)
    settings = [
        "-p",
        f"sample_period:={period}",
        "-p",
        "lvdt.hold_samples:=200",
        "-p",
        "lvdt.period_limit:=0.15",
    ]
    settings += ["-p", "reshaping.natural_frequency:=100.0", "-p", "controller:=open_loop"]
    with (
        process("valve_simulator", ["-p", "sample_period:=0.01"], tmp_path / "valve.log"),
        controller(tmp_path, *settings),
    ):
        ear.hear("controller", f"ms, sample_period is {1e3 * period:g} ms{word}")
    assert ("→ safe: " in (tmp_path / "c.log").read_text().replace("off → safe", "")) == bool(word)
