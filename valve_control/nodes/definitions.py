# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Looks up message types by name: their Python class, their definition as rosbag2 stores it, their hash."""

import importlib
from pathlib import Path
from typing import Any, NamedTuple

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


class Definition(NamedTuple):
    """What a bag stores about a message type."""

    text: str  # ros2msg, with the types that it needs; "" if it cannot be had
    type_hash: str  # RIHS01_…; "" if it cannot be had


def message_class(type_name: str) -> Any:
    """Python class of a type such as ``std_msgs/msg/Float64``. Raises LookupError if it is not installed."""
    package, _, name = type_name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise LookupError(f"message type {type_name} is not installed") from error


class Definitions:
    """Definitions of the types of Jazzy, and of the message packages that are installed."""

    def __init__(self) -> None:
        self._store: Typestore = get_typestore(Stores.ROS2_JAZZY)

    def get(self, type_name: str) -> Definition:
        """Definition of ``type_name``. Raises LookupError if there is none."""
        try:
            self._learn(type_name)
            text, _ = self._store.generate_msgdef(type_name, ros_version=2)
            return Definition(text, self._store.hash_rihs01(type_name))
        except (PackageNotFoundError, OSError) as error:
            raise LookupError(f"there is no definition of {type_name}") from error
        except Exception as error:  # rosbags has several kinds for a definition that it does not understand
            raise LookupError(f"the definition of {type_name} is not understood: {error}") from error

    def trimmed(self, data: bytes, type_name: str) -> bytes:
        """``data`` of rclpy's serialize_message without what follows the message.

        rclpy gives the buffer that it estimated, whose rest is memory that was never written.
        """
        message = self._store.get_msgdef(type_name)
        _, end = message.deserialize_cdr_le(memoryview(data)[4:], 0, message.cls, self._store)
        return data[: 4 + end]

    def _learn(self, type_name: str) -> None:
        """Read a type that Jazzy does not have, and those that it needs, from their packages."""
        if type_name in self._store.fielddefs:
            return
        package, _, name = type_name.partition("/msg/")
        path = Path(get_package_share_directory(package)) / "msg" / f"{name}.msg"
        types = get_types_from_msg(path.read_text(encoding="utf-8"), type_name)
        for _, fields in types.values():
            for _, field in fields:
                needed = _base(field)
                if needed[0] == Nodetype.NAME and needed[1] not in types:
                    self._learn(needed[1])
        self._store.register(types)


def _base(field: Any) -> tuple[Nodetype, str]:
    """Kind and type name of a field, or of the entries if the field is an array."""
    kind, detail = field
    return _base(detail[0]) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, str(detail))
