# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Sees to what the middleware needs of a process: how Fast DDS carries its messages, and where it may log."""

from collections.abc import Mapping, MutableMapping
from pathlib import Path

from valve_control.parameter import ParameterError

ANYWHERE = str(Path(__file__).with_name("fast_dds.xml"))
THIS_HOST = str(
    Path(__file__).with_name("fast_dds_this_host.xml")
)  # the same, and discovery on this host alone
VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
OWN_CHOICE = (VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
OWN_FILE = "DEFAULT_FASTRTPS_PROFILES.xml"  # in the working folder, which Fast DDS reads by itself
FAST_DDS = "rmw_fastrtps"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def use_own_profile(environment: MutableMapping[str, str]) -> None:
    """Let Fast DDS use the package's profile; call it before the process's first node.

    For the range LOCALHOST rmw_fastrtps adds shared memory to whatever a profile says; so the profile itself
    keeps discovery on this host, and the range is left to it.
    """
    middleware = environment.get("RMW_IMPLEMENTATION") or FAST_DDS
    choices = {environment.get(name) or ANYWHERE for name in OWN_CHOICE}
    if not middleware.startswith(FAST_DDS) or choices - {ANYWHERE, THIS_HOST} or Path(OWN_FILE).exists():
        return
    if environment.get(RANGE) == "LOCALHOST" and not environment.get("ROS_STATIC_PEERS"):
        environment[RANGE] = "SYSTEM_DEFAULT"
        environment[VARIABLE] = THIS_HOST
    elif THIS_HOST not in choices or environment.get(RANGE) != "SYSTEM_DEFAULT":
        environment[VARIABLE] = ANYWHERE


def check_log_folder(environment: Mapping[str, str]) -> None:
    """Raise ParameterError if there is no folder for the logs of ROS, before rcl says so without its name."""
    home, ros_home = environment.get("HOME"), environment.get("ROS_HOME")
    below = ros_home or (f"{home}/.ros" if home else "")
    folder = environment.get("ROS_LOG_DIR") or (f"{below}/log" if below else "")
    if not folder:
        raise ParameterError("ROS writes its logs below HOME, which is not set; set HOME or ROS_LOG_DIR")
    try:
        Path(folder).expanduser().mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        text = f"the folder of ROS's logs, {folder}, cannot be made: {reason}; set ROS_LOG_DIR"
        raise ParameterError(text) from error


def leave_own_profile(environment: MutableMapping[str, str]) -> None:
    """Undo ``use_own_profile``: Fast DDS uses its usual transports."""
    profile = environment.get(VARIABLE)
    if profile in (ANYWHERE, THIS_HOST):
        del environment[VARIABLE]
    if profile == THIS_HOST:
        environment[RANGE] = "LOCALHOST"
