# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads and writes metadata.yaml of rosbag2 bags: reads versions 1 to 9, writes 9 (ROS 2 Jazzy)."""

from collections.abc import Iterable
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import yaml
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos

from valve_control import outputs
from valve_control.control.parameters.ros_file import parsed
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Topic

NAME = "metadata.yaml"
VERSION = 9
ROOT = "rosbag2_bagfile_information"
DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class Listing(NamedTuple):
    """What a reader needs of a metadata.yaml; without arguments that of a bag without one."""

    version: int | None = None
    distribution: str = ""
    compression: str = ""  # file, message or ""
    message_count: int = 0
    files: tuple[str, ...] = ()


# Writing


def as_text(tree: Any) -> str:
    """YAML text as storage files contain it."""
    text: str = yaml.dump(
        tree, Dumper=DUMPER, sort_keys=False, default_flow_style=False, width=10**6, allow_unicode=True
    )
    return text.strip()


def write(folder: Path, tree: dict[str, Any]) -> None:
    """Write metadata.yaml of version 9 into ``folder``, whole or not at all. Raises OSError."""
    outputs.write(str(folder / NAME), as_text({ROOT: tree}) + "\n")


def of_file(
    storage: str, name: str, begin: int, end: int, topics: Iterable[tuple[Topic, int]]
) -> dict[str, Any]:
    """Content of metadata.yaml of a bag with one file ``name`` from ``begin`` to ``end`` [ns since 1970].

    ``topics``: each with the number of its messages.
    """
    counted = list(topics)
    extent: dict[str, Any] = {
        "starting_time": {"nanoseconds_since_epoch": begin},
        "duration": {"nanoseconds": end - begin},
        "message_count": sum(count for _, count in counted),
    }
    return {
        "version": VERSION,
        "storage_identifier": storage,
        **extent,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": topic.encoding,
                    "offered_qos_profiles": parsed(topic.qos) if topic.qos else [],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": count,
            }
            for topic, count in counted
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name],
        "files": [{"path": name, **extent}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


# Reading


def read(folder: Path) -> Listing:
    """Listing of the bag in ``folder``, of any version. Raises BagError."""
    path = folder / NAME
    try:
        bag = parsed(path.read_text(encoding="utf-8"))[ROOT]
        mode = str(bag.get("compression_mode", "")).lower()
        listing = Listing(
            version=int(bag["version"]),
            distribution=str(bag.get("ros_distro", "")),
            compression="" if mode == "none" else mode,
            message_count=int(bag["message_count"]),
            # Before version 4 the paths began with the bag's own folder.
            files=tuple(dict.fromkeys(PurePath(str(name)).name for name in bag["relative_file_paths"])),
        )
    except OSError as error:
        raise BagError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BagError(f"{path} does not describe a bag: {type(error).__name__} {error}") from error
    if listing.compression and bag.get("compression_format") != "zstd":
        raise BagError(f"{folder} is compressed with {bag.get('compression_format')!r}; zstd is known")
    return listing


def profiles(text: str) -> tuple[Qos, ...]:
    """QoS profiles from their YAML ``text`` in a storage file, () if they cannot be read."""
    try:
        return tuple(parse_qos(text))
    except Exception:  # rosbags raises what it meets
        return ()
