# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads and writes metadata.yaml of rosbag2 bags: reads versions 1 to 9, writes 9 (ROS 2 Jazzy)."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any, NamedTuple, TypeVar

import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from valve_control import inputs, outputs
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.placeholders import refuse

NAME = "metadata.yaml"
VERSION = 9
ROOT = "rosbag2_bagfile_information"
DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

# Names that version 9 writes, at the numbers that older versions write. rosbags' parse_qos would read them,
# but it takes any depth and time, and raises KeyError, TypeError or AttributeError for what is no profile.
POLICIES: Mapping[str, Any] = {
    "history": QosHistory,
    "reliability": QosReliability,
    "durability": QosDurability,
    "liveliness": QosLiveliness,
}

T = TypeVar("T")


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
    files: tuple[File, ...]  # empty in versions before 5
    relative_file_paths: tuple[str, ...]
    version: int = VERSION
    compression_format: str = ""
    compression_mode: str = ""
    ros_distro: str = "jazzy"
    custom_data: Mapping[str, str] | None = None


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
        "compression_format": metadata.compression_format,
        "compression_mode": metadata.compression_mode,
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
        "custom_data": dict(metadata.custom_data) if metadata.custom_data else None,
        "ros_distro": metadata.ros_distro,
    }


# Reading


def read(folder: Path) -> Metadata:
    """Metadata of the bag in ``folder``. Raises BagError."""
    path = folder / NAME
    try:
        refuse(path)
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BagError(f"{folder} has no {NAME}; a bag is a folder with one") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    return parse(text, str(path))


def parse(text: str, source: str) -> Metadata:
    """Metadata from the YAML ``text``, read from ``source``. Raises BagError."""
    try:
        tree = inputs.from_yaml(text)
    except ValueError as error:
        raise BagError(f"{source} is not YAML: {error}") from error
    try:
        return _metadata(tree)
    except _Unknown as error:
        raise UnknownVersionError(f"{source}: {error}") from error
    except _Wrong as error:
        raise BagError(f"{source}: {error}") from error


def parse_qos(profiles: object) -> tuple[Qos, ...]:
    """Profiles from a list or its YAML text, policies as names or as numbers. Raises BagError."""
    if isinstance(profiles, str):
        try:
            profiles = inputs.from_yaml(profiles)
        except ValueError as error:
            raise BagError(f"offered_qos_profiles is not YAML: {error}") from error
    if not profiles:
        return ()
    if not isinstance(profiles, list):
        raise BagError(f"offered_qos_profiles is {profiles!r}; it must be a list")
    try:
        return tuple(_qos(tree) for tree in profiles)
    except _Wrong as error:
        raise BagError(f"offered_qos_profiles: {error}") from error


class UnknownVersionError(BagError):
    """Says that a bag has a version that is not known."""


class _Wrong(ValueError):
    """Says what is wrong with a part of the file."""


class _Unknown(_Wrong):
    """Says that the version is not known."""


def _get(tree: object, key: str, kind: type[T]) -> T:
    """``tree[key]``, which must be of the type ``kind``."""
    if not isinstance(tree, dict) or key not in tree:
        raise _Wrong(f"'{key}' is missing")
    value = tree[key]
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise _Wrong(f"'{key}' is {value!r}; it must be {KINDS[kind]}")
    return value


KINDS: Mapping[type, str] = {int: "a whole number", str: "a text", list: "a list", dict: "a mapping"}


def _metadata(tree: object) -> Metadata:
    bag = _get(tree, ROOT, dict)
    version = _get(bag, "version", int)
    if version > VERSION:
        raise _Unknown(f"it is of version {version}; versions up to {VERSION} are known")
    return Metadata(
        storage_identifier=_get(bag, "storage_identifier", str),
        starting_time=_start(bag),
        duration=_duration(bag),
        message_count=_get(bag, "message_count", int),
        topics=tuple(
            Counted(_topic(_get(entry, "topic_metadata", dict), version), _get(entry, "message_count", int))
            for entry in _get(bag, "topics_with_message_count", list)
        ),
        files=tuple(
            File(
                PurePath(_get(entry, "path", str)).name,
                _start(entry),
                _duration(entry),
                _get(entry, "message_count", int),
            )
            for entry in (_get(bag, "files", list) if version >= 5 else [])
        ),
        # Before version 4 the paths began with the bag's own folder.
        relative_file_paths=tuple(PurePath(str(p)).name for p in _get(bag, "relative_file_paths", list)),
        version=version,
        compression_format=_get(bag, "compression_format", str) if version >= 3 else "",
        compression_mode=_get(bag, "compression_mode", str) if version >= 3 else "",
        ros_distro=_get(bag, "ros_distro", str) if version >= 8 else "",
        custom_data=_custom_data(bag),
    )


def _start(tree: object) -> int:
    return _get(_get(tree, "starting_time", dict), "nanoseconds_since_epoch", int)


def _duration(tree: object) -> int:
    return _get(_get(tree, "duration", dict), "nanoseconds", int)


def _custom_data(bag: dict[str, Any]) -> dict[str, str] | None:
    data = bag.get("custom_data")
    return {str(key): str(value) for key, value in data.items()} if isinstance(data, dict) and data else None


def _topic(tree: object, version: int) -> TopicMetadata:
    try:
        profiles = parse_qos(tree.get("offered_qos_profiles", "") if isinstance(tree, dict) else "")
    except BagError as error:
        raise _Wrong(str(error)) from error
    return TopicMetadata(
        name=_get(tree, "name", str),
        type=_get(tree, "type", str),
        serialization_format=_get(tree, "serialization_format", str),
        offered_qos_profiles=profiles,
        type_description_hash=_get(tree, "type_description_hash", str) if version >= 7 else "",
    )


def _qos(tree: object) -> Qos:
    return Qos(
        history=_policy(tree, "history"),
        depth=_get(tree, "depth", int),
        reliability=_policy(tree, "reliability"),
        durability=_policy(tree, "durability"),
        deadline=_time(tree, "deadline"),
        lifespan=_time(tree, "lifespan"),
        liveliness=_policy(tree, "liveliness"),
        liveliness_lease_duration=_time(tree, "liveliness_lease_duration"),
        avoid_ros_namespace_conventions=bool(
            isinstance(tree, dict) and tree.get("avoid_ros_namespace_conventions")
        ),
    )


def _policy(tree: object, key: str) -> Any:
    value = _get(tree, key, object)
    members = POLICIES[key]
    return next((one for one in members if value in (one.value, one.name.lower())), members.UNKNOWN)


def _time(tree: object, key: str) -> QosTime:
    span = _get(tree, key, dict)
    return QosTime(_get(span, "sec", int), _get(span, "nsec", int))
