# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines messages and topics in the form in which the readers of both storages return them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Bytes, Integers

CDR = "cdr"  # the serialization of ROS 2 messages, the only one that is read


class Topic(NamedTuple):
    """A topic with type, QoS and message definition, as the bag states them."""

    name: str
    type: str
    encoding: str = "cdr"
    definition_format: str = ""  # ros2msg, ros2idl, or "" where the bag has none
    definition: str = ""
    type_hash: str = ""
    qos: str = ""  # profiles that its publishers offer, as YAML; "" if unknown
    flaw: str = ""  # why a column of a table cannot be used, "" if it can

    @property
    def unreadable(self) -> str:
        """Why its messages cannot be read, whatever is in them; "" if they can."""
        if self.flaw:
            return self.flaw
        if self.encoding != CDR:
            kind = self.type or "no type"
            encoding = f"is serialized as {self.encoding}" if self.encoding else "names no serialization"
            return f"{self.name} ({kind}) {encoding}; only {CDR} can be read"
        return "" if self.type else f"{self.name} ({self.encoding}) has no schema, so its type is not known"


class Block(NamedTuple):
    """Messages in the order of the file; message i is ``buffer[offset[i] : offset[i] + length[i]]``."""

    buffer: Bytes
    topic: Integers  # index into the topics of the file
    log_time: Integers  # ns
    publish_time: Integers  # ns, the log time where the storage has none
    sequence: Integers  # of the publisher, 0 where the storage has none
    place: Integers  # among all messages: of the block, or of the bag
    offset: Integers
    length: Integers

    def contents(self) -> Iterator[bytes]:
        """Yield the messages themselves."""
        for at, size in zip(self.offset.tolist(), self.length.tolist(), strict=True):
            yield self.buffer[at : at + size].tobytes()

    def select(self, chosen: npt.NDArray[np.bool_]) -> "Block":
        """The messages chosen by a mask."""
        at = np.flatnonzero(chosen)
        return self if len(at) == len(chosen) else Block(self.buffer, *(column[at] for column in self[1:]))


def absolute(name: str) -> str:
    """Name of a topic with a leading slash, which some recorders leave out."""
    return name if name.startswith("/") else f"/{name}"


def full_type(name: str) -> str:
    """Full name of a type, such as std_msgs/msg/Float64.

    Some recorders write std_msgs/Float64, std_msgs::msg::Float64 or, as DDS, std_msgs::msg::dds_::Float64_.
    """
    if "::dds_::" in name:
        name = name.replace("::dds_::", "::").removesuffix("_")
    name = name.replace("::", "/")
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if package and slash and rest and "/" not in rest else name
