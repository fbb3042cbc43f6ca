# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A second controller on one valve, and an LVDT of another rate, over real DDS."""

import signal
import time

import pytest
from bench import controller, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float32

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


STANDS_BY = "another publisher on valve_voltage controls this valve"


def test_of_two_controllers_on_one_valve_the_second_stands_by_until_the_first_ends(ros, tmp_path):
    """A third one that only publishes is reported by all."""
    ear, second = Ear(ros), ["-r", "__node:=other", "-p", "command_timeout:=0.0"]
    with process("valve_simulator", [], tmp_path / "valve.log"), controller(tmp_path) as first:
        ear.hear("controller", "no command yet")
        time.sleep(right_of_way.YOUNG)
        with process("controller", second, tmp_path / "other.log"):
            for node in ("controller", "other"):
                ear.hear(node, "2 publishers on valve_voltage")
            ear.hear("other", STANDS_BY)
        ear.hear_no_more("controller", "2 publishers on valve_voltage")
        assert STANDS_BY not in (tmp_path / "c.log").read_text()
        ear.said.clear()
        with process("controller", second, tmp_path / "other_again.log"):
            ear.hear("other", STANDS_BY)
            first.send_signal(signal.SIGTERM)
            first.wait(10.0)
            ear.hear_no_more("other", STANDS_BY)
            ear.hear("other", "no command yet")


def test_a_publisher_of_another_message_type_is_named_as_such(ros, tmp_path):
    """It was told as 2 publishers."""
    ear = Ear(ros)
    with controller(tmp_path):
        wrong = ros.create_publisher(Float32, "spool_command", 10)
        word = "1 of the publishers on spool_command have another message type than std_msgs/msg/Float64"
        ear.hear("controller", word)
        ros.destroy_publisher(wrong)
        ear.hear_no_more("controller", word)


def alone(ways, gids, age, windows=40):
    """The windows in which each of several controllers, active since ``age`` [s], gives voltages."""
    ages, given = list(age), []
    for _ in range(windows):
        gives = [not way.stands_by for way in ways]
        given.append(gives)
        after = []
        for i, way in enumerate(ways):
            others = 200 * (sum(gives) - gives[i])
            after.append(right_of_way.step(way, others, ages[i], gids[i] == min(gids)))
            ages[i] = 0.0 if way.stands_by and not after[i].stands_by else ages[i] + 0.2
        ways = after
    return given


@pytest.mark.parametrize("gids", [(1, 2), (2, 1)])
@pytest.mark.parametrize("age", [(9.0, 0.0), (0.0, 9.0), (0.0, 0.0), (9.0, 9.0)])
def test_of_two_that_run_exactly_one_goes_on(gids, age):
    """The older one; of two that began together, or that meet late, the one with the smaller GID."""
    given = alone([right_of_way.ACTIVE, right_of_way.ACTIVE], gids, age)
    assert all(sum(gives) == 1 for gives in given[10:]) and all(gives == given[10] for gives in given[10:])
    assert given[10].index(True) == (gids.index(1) if age[0] == age[1] else age.index(9.0))
