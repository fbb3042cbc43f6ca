# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes do without the shared memory of Fast DDS, on this host and beside others that have it."""

from contextlib import ExitStack
from pathlib import Path

import pytest
from bench import spin_until
from std_msgs.msg import Float64

from research.campaigns.joiners import crowd
from research.campaigns.processes import leave_own_profile, process
from valve_control.nodes.transport import (
    ANYWHERE,
    THIS_HOST,
    use_own_profile,
)

NEWER = "FASTDDS_DEFAULT_PROFILES_FILE"
PROFILE, RANGE = "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"


def test_the_profile_follows_the_installed_fast_dds_and_the_range_of_discovery(tmp_path):
    """Fast DDS 3 does not read the variable of version 2, and rmw_fastrtps warns of it in each process."""
    kilted = tmp_path / "kilted"
    (kilted / "share" / "fastdds").mkdir(parents=True)
    for given, variable, profile, wanted in (
        ({}, PROFILE, ANYWHERE, None),
        ({"AMENT_PREFIX_PATH": f"/nosuch:{kilted}"}, NEWER, ANYWHERE, None),
        ({RANGE: "SUBNET"}, PROFILE, ANYWHERE, "SUBNET"),
        ({RANGE: "LOCALHOST"}, PROFILE, THIS_HOST, "SYSTEM_DEFAULT"),
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.2"}, PROFILE, ANYWHERE, "LOCALHOST"),
        ({PROFILE: THIS_HOST, RANGE: "SUBNET"}, PROFILE, ANYWHERE, "SUBNET"),
    ):
        environment = dict(given)
        use_own_profile(environment)
        assert environment[variable] == profile and Path(profile).is_file()
        assert environment.get(RANGE) == wanted
        leave_own_profile(environment)
        assert variable not in environment
        assert environment.get(RANGE) == ("LOCALHOST" if profile == THIS_HOST else wanted)


@pytest.mark.parametrize(
    "own",
    [
        {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"},
        {PROFILE: "mine.xml"},
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
        {},
    ],
)
def test_a_choice_of_the_user_and_another_middleware_are_left_alone(tmp_path, monkeypatch, own):
    """Without a variable it is a profile in the working folder."""
    monkeypatch.chdir(tmp_path)
    if not own:
        (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text("<dds/>")
    given = {RANGE: "LOCALHOST", **own}
    environment = dict(given)
    use_own_profile(environment)
    assert environment == given


def shared_memory(pid):
    """What the process has mapped of anybody's Fast DDS shared memory."""
    return [line for line in Path(f"/proc/{pid}/maps").read_text().splitlines() if "/dev/shm/fast" in line]


@pytest.mark.alone
def test_nodes_and_others_with_shared_memory_hear_each_other_by_udp(ros, tmp_path):
    """Half of the crowd has the transports of everybody; each hears something before it is killed."""
    children = {}
    voltages = []
    ros.create_subscription(Float64, "valve_voltage", lambda m: voltages.append(m.data), 10)
    with ExitStack() as stack:
        for name in ("controller", "valve_simulator", "command_source"):
            children[name] = stack.enter_context(process(name, [], tmp_path / f"{name}.log"))
        spin_until(ros, lambda: len(voltages) > 100, "the closed loop")
        with crowd(4, tmp_path / "crowd.txt") as crew:
            spin_until(ros, crew.over, "four that came and went", 60.0)
            assert len(crew.costs()) == 4
        for name, child in children.items():
            assert shared_memory(child.pid) == [], name
