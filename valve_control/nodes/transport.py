# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Chooses how Fast DDS carries the messages of a process."""

import os
from collections.abc import Mapping, MutableMapping
from pathlib import Path

ANYWHERE = str(Path(__file__).with_name("fast_dds.xml"))
THIS_HOST = str(Path(__file__).with_name("fast_dds_this_host.xml"))  # discovery on this host alone
VERSION_2, VERSION_3 = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
OWN_CHOICE = (VERSION_2, VERSION_3, "FASTDDS_BUILTIN_TRANSPORTS")
# In the working folder, which Fast DDS reads by itself.
OWN_FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
FAST_DDS = "rmw_fastrtps"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def profile_variable(environment: Mapping[str, str]) -> str:
    """Variable with the profile's file: Fast DDS 3 (ROS 2 Kilted) has another than version 2 (Jazzy)."""
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    newer = any(Path(prefix, "share", "fastdds").is_dir() for prefix in prefixes if prefix)
    return VERSION_3 if newer else VERSION_2


def use_own_profile(environment: MutableMapping[str, str]) -> None:
    """Let Fast DDS use the package's profile; call it before the process's first node.

    For the range LOCALHOST rmw_fastrtps adds shared memory to whatever a profile says; so the profile itself
    keeps discovery on this host, and the range is left to it.
    """
    middleware = environment.get("RMW_IMPLEMENTATION") or FAST_DDS
    choices = {environment.get(name) or ANYWHERE for name in OWN_CHOICE}
    own = choices - {ANYWHERE, THIS_HOST} or any(Path(name).exists() for name in OWN_FILES)
    if own or not middleware.startswith(FAST_DDS):
        return
    variable = profile_variable(environment)
    if environment.get(RANGE) == "LOCALHOST" and not environment.get("ROS_STATIC_PEERS"):
        environment[RANGE] = "SYSTEM_DEFAULT"
        environment[variable] = THIS_HOST
    elif THIS_HOST not in choices or environment.get(RANGE) != "SYSTEM_DEFAULT":
        environment[variable] = ANYWHERE
