# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes the file of a new bag: MCAP."""

from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from valve_control.recordings.bags.messages import Topic
from valve_control.recordings.bags.sqlite_writer import OVERHEAD, PENDING

COMPRESSION = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
LIBRARY = "valve_control"


class McapWriter:
    """An MCAP file of profile ros2."""

    def __init__(self, path: Path, compression: str) -> None:
        self.pending = 0
        self._file = path.open("xb")
        self._writer: Any = Writer(self._file, chunk_size=2 * PENDING, compression=COMPRESSION[compression])
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._writer.start("ros2", LIBRARY)
        self.flush()

    def add_topic(self, topic: Topic) -> None:
        """Add a channel, and the schema of its type."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, topic.definition_format, topic.definition.encode()
            )
        about = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash}
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, topic.encoding, self._schemas[topic.type], about
        )

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message to the open chunk."""
        self._writer.add_message(self._channels[topic], log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self.pending += OVERHEAD + len(data)

    def size(self) -> int:
        """Size of the file [bytes], with what is buffered."""
        return self._size + self.pending

    def flush(self) -> None:
        """End the open chunk and write it. Raises OSError."""
        self._writer.flush()
        self._file.flush()
        self._size = self._file.tell()
        self.pending = 0

    def finish(self, text: str) -> None:
        """Write the bag's metadata, summary and footer. Raises OSError."""
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
        self._writer.finish()
        self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, whose whole chunks can be read. Raises OSError."""
        self._file.close()
