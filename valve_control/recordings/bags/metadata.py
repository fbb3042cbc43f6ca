# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads and writes metadata.yaml of rosbag2 bags: reads versions 1 to 9, writes 9 (ROS 2 Jazzy)."""

from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import yaml
from rosbags.interfaces import Qos, QosTime
from rosbags.rosbag2.metadata import parse_qos

from valve_control import inputs, outputs
from valve_control.recordings.bags.errors import BagError, refuse_pointer
from valve_control.recordings.bags.messages import CDR, absolute

NAME = "metadata.yaml"
VERSION = 9
ROOT = "rosbag2_bagfile_information"
DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

POLICIES = ("history", "reliability", "durability", "liveliness")


class TopicMetadata(NamedTuple):
    """A topic of a bag."""

    name: str
    type: str
    serialization_format: str = "cdr"
    offered_qos_profiles: tuple[Qos, ...] = ()
    type_description_hash: str = ""


class Counted(NamedTuple):
    """A topic and the number of its messages."""

    topic: TopicMetadata
    message_count: int


class File(NamedTuple):
    """A storage file of a bag."""

    path: str  # relative to the bag's folder
    starting_time: int  # ns since 1970, of the earliest message; 0 without messages
    duration: int  # ns, to the latest message
    message_count: int


class Metadata(NamedTuple):
    """Content of a metadata.yaml."""

    storage_identifier: str  # mcap or sqlite3
    starting_time: int  # ns since 1970
    duration: int  # ns
    message_count: int
    topics: tuple[Counted, ...]
    files: tuple[File, ...]
    relative_file_paths: tuple[str, ...]


class Listing(NamedTuple):
    """What a reader needs of a metadata.yaml."""

    version: int
    distribution: str
    compression: str  # file, message or ""
    message_count: int
    files: tuple[str, ...]
    formats: dict[str, str]  # serialization by topic, where it is another than CDR


def of_files(storage: str, topics: Iterable[Counted], files: Sequence[File]) -> Metadata:
    """Metadata of a bag of ``storage`` from its topics and files."""
    filled = [file for file in files if file.message_count]
    start = min((file.starting_time for file in filled), default=0)
    end = max((file.starting_time + file.duration for file in filled), default=0)
    return Metadata(
        storage_identifier=storage,
        starting_time=start,
        duration=end - start,
        message_count=sum(file.message_count for file in files),
        topics=tuple(topics),
        files=tuple(files),
        relative_file_paths=tuple(file.path for file in files),
    )


# Writing


def qos_text(profiles: Sequence[Qos]) -> str:
    """QoS profiles as the YAML text that storage files contain."""
    return _dump([_qos_tree(qos) for qos in profiles]).strip() if profiles else ""


def as_text(metadata: Metadata) -> str:
    """YAML text of version 9 without its root key, as storage files contain it."""
    return _dump(_tree(metadata)).strip()


def write(folder: Path, metadata: Metadata) -> None:
    """Write metadata.yaml of version 9 into ``folder``, whole or not at all. Raises OSError."""
    outputs.write(str(folder / NAME), _dump({ROOT: _tree(metadata)}))


def _dump(tree: Any) -> str:
    text: str = yaml.dump(
        tree, Dumper=DUMPER, sort_keys=False, default_flow_style=False, width=10**6, allow_unicode=True
    )
    return text


def _qos_tree(qos: Qos) -> dict[str, Any]:
    times = {name: value._asdict() for name, value in qos._asdict().items() if isinstance(value, QosTime)}
    return qos._asdict() | {name: getattr(qos, name).name.lower() for name in POLICIES} | times


def _tree(metadata: Metadata) -> dict[str, Any]:
    return {
        "version": VERSION,
        "storage_identifier": metadata.storage_identifier,
        "duration": {"nanoseconds": metadata.duration},
        "starting_time": {"nanoseconds_since_epoch": metadata.starting_time},
        "message_count": metadata.message_count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    **topic._asdict(),
                    "offered_qos_profiles": [_qos_tree(qos) for qos in topic.offered_qos_profiles],
                },
                "message_count": count,
            }
            for topic, count in metadata.topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(metadata.relative_file_paths),
        "files": [
            {
                "path": file.path,
                "starting_time": {"nanoseconds_since_epoch": file.starting_time},
                "duration": {"nanoseconds": file.duration},
                "message_count": file.message_count,
            }
            for file in metadata.files
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


# Reading


def read(folder: Path) -> Listing:
    """Listing of the bag in ``folder``, of any version. Raises BagError."""
    path = folder / NAME
    try:
        refuse_pointer(path)
        bag = inputs.from_yaml(path.read_text(encoding="utf-8"))[ROOT]
        version = int(bag["version"])
        mode = str(bag.get("compression_mode", "")).lower()
        topics = [entry["topic_metadata"] for entry in bag["topics_with_message_count"]]
        listing = Listing(
            version=version,
            distribution=str(bag.get("ros_distro", "")),
            compression="" if mode == "none" else mode,
            message_count=int(bag["message_count"]),
            # Before version 4 the paths began with the bag's own folder.
            files=tuple(dict.fromkeys(PurePath(str(name)).name for name in bag["relative_file_paths"])),
            formats={
                absolute(topic["name"]): topic["serialization_format"]
                for topic in topics
                if topic["serialization_format"] != CDR
            },
        )
    except OSError as error:
        raise BagError(f"{path} cannot be read: {error.strerror or error}") from error
    except BagError:
        raise
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
