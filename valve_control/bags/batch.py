"""What the storages give: serialized messages of several topics in one buffer."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml

Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int64]


class Topic(NamedTuple):
    """A topic as the bag describes it."""

    name: str
    type: str
    encoding: str = "cdr"
    definition_format: str = ""  # ros2msg, ros2idl, or "" where the bag has none
    definition: str = ""
    type_hash: str = ""
    qos: tuple[dict[str, Any], ...] = ()  # offered by each publisher; () if unknown


class Batch(NamedTuple):
    """Messages in the order of the file; message i is ``buffer[offset[i] : offset[i] + length[i]]``."""

    buffer: Bytes
    topic: Integers  # index into the topics of the file
    log_time: Integers  # ns
    publish_time: Integers  # ns, the log time where the storage has none
    sequence: Integers  # of the publisher, 0 where the storage has none
    offset: Integers
    length: Integers

    def select(self, chosen: npt.NDArray[Any]) -> "Batch":
        """Some of its messages, by mask or index."""
        return Batch(self.buffer, *(column[chosen] for column in self[1:]))


def qos_profiles(text: str) -> tuple[dict[str, Any], ...]:
    """QoS profiles from their YAML text, () if it cannot be read."""
    try:
        profiles = yaml.safe_load(text) if text else []
    except yaml.YAMLError:
        return ()
    return tuple(p for p in profiles if isinstance(p, dict)) if isinstance(profiles, list) else ()
