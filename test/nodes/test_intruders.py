# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A second controller on one valve, and an LVDT of another rate, over real DDS."""

import signal
import time
from types import SimpleNamespace

import pytest
from bench import controller, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from std_msgs.msg import Float32
from test_lifecycle import change, state

from research.campaigns.processes import process
from valve_control.nodes import right_of_way


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


ANOTHER = "another publisher on valve_voltage controls this valve: end it, then activate this controller"


def test_of_two_controllers_on_one_valve_the_second_deactivates_itself(ros, tmp_path):
    """A third one that only publishes is reported by all."""
    ear, second = Ear(ros), ["-r", "__node:=other", "-p", "command_timeout:=0.0"]
    with process("valve_simulator", [], tmp_path / "valve.log"), controller(tmp_path) as first:
        ear.hear("controller", "no command yet")
        time.sleep(right_of_way.YOUNG)
        with process("controller", second, tmp_path / "other.log"):
            ear.hear("controller", "2 publishers on valve_voltage")
            ear.hear("other", ANOTHER)
            assert state(ros, "other") == "inactive" and state(ros, "controller") == "active"
            first.send_signal(signal.SIGTERM)
            first.wait(10.0)
            assert change(ros, "other", Transition.TRANSITION_ACTIVATE)
            ear.hear("other", "no command yet")
    assert ANOTHER not in (tmp_path / "c.log").read_text()


class Voltages:
    """Voltages that have come to a subscription."""

    waiting = 0

    def __init__(self, *arguments):
        """Whatever the node and its topic are."""

    def take(self):
        taken, self.waiting = self.waiting, 0
        return [0.0] * taken

    def destroy(self):
        self.waiting = 0


@pytest.mark.parametrize(("given", "windows"), [(0, right_of_way.SURE), (2000, right_of_way.BOTH)])
def test_an_old_controller_stops_later_than_a_young_one(monkeypatch, given, windows):
    """Two old ones that meet late both stop; few voltages of others are an error of the count."""
    now, period = [0.0], 0.001
    monkeypatch.setattr(right_of_way, "NumberSubscription", Voltages)
    monkeypatch.setattr(right_of_way, "time", SimpleNamespace(monotonic=lambda: now[0]))
    rivals, stops = right_of_way.Rivals(None), []
    rivals.given = given
    rivals.listen(True, period)
    for others in (0, right_of_way.MOST, *[200] * windows):
        assert not rivals.control(period), "the window has not ended"
        now[0] += right_of_way.WINDOW
        rivals.given += 200
        rivals._subscription.waiting = 200 + others
        stops.append(rivals.control(period))
    assert stops == [False] * (windows + 1) + [True]


def test_a_publisher_of_another_message_type_is_named_as_such(ros, tmp_path):
    """It was told as 2 publishers."""
    ear = Ear(ros)
    with controller(tmp_path):
        wrong = ros.create_publisher(Float32, "spool_command", 10)
        word = "1 of the publishers on spool_command have another message type than std_msgs/msg/Float64"
        ear.hear("controller", word)
        ros.destroy_publisher(wrong)
        ear.hear_no_more("controller", word)
