# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Storage file of a new bag: MCAP."""

import copy
import errno
import os
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.metadata import TopicMetadata
from valve_control.recordings.bags.storage import OVERHEAD, PENDING, Definition

COMPRESSION = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
LIBRARY = "valve_control"
OWN = "_Writer__"  # prefix of the state of mcap's writer


class Output:
    """File for the MCAP writer: each flush is one write, and a failed one can be taken back."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._waiting: list[bytes] = []
        self._position = 0
        self.flushed = 0

    def write(self, data: bytes) -> int:
        """Buffer ``data``."""
        self._waiting.append(data)
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Position after all buffered data."""
        return self._position

    def flush(self) -> None:
        """Write what is buffered. Raises OSError."""
        rest = memoryview(b"".join(self._waiting))
        while rest:
            rest = rest[self._file.write(rest) :]
        self._waiting.clear()
        self.flushed = self._position

    def is_at(self, path: Path) -> bool:
        """Whether it is this file that has the name ``path``. Raises OSError."""
        return os.path.samestat(os.fstat(self._file.fileno()), path.stat())

    def take_back(self) -> None:
        """Go back to the last successful flush. Raises OSError."""
        self._waiting.clear()
        self._position = self._file.seek(self.flushed)
        self._file.truncate()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class McapStorage:
    """An MCAP file of profile ros2."""

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        self.pending = 0
        self._output = Output(path)
        output: Any = self._output
        self._writer: Any = Writer(output, chunk_size=2 * PENDING, compression=COMPRESSION[compression])
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._writer.start("ros2", LIBRARY)
        self.flush()

    def add_topic(self, topic: TopicMetadata, definition: Definition) -> None:
        """Add a channel, and the schema of its type."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, definition.format, definition.text.encode()
            )
        self._channels[topic.name] = self._writer.register_channel(
            topic.name,
            topic.serialization_format,
            self._schemas[topic.type],
            {
                "offered_qos_profiles": metadata.qos_text(topic.offered_qos_profiles),
                "topic_type_hash": topic.type_description_hash,
            },
        )

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message to the open chunk."""
        self._writer.add_message(self._channels[topic], log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self.pending += OVERHEAD + len(data)

    def size(self) -> int:
        """Size of the file [bytes], with what is buffered."""
        return self._output.tell() + self.pending

    def flush(self) -> None:
        """End the open chunk and write it."""
        self._writer.flush()
        self.pending = 0
        state = vars(self._writer)  # the library has no way back from a failed write
        self._flushed = len(state[f"{OWN}chunk_indices"]), copy.deepcopy(state[f"{OWN}statistics"])

    def finish(self, text: str) -> None:
        """Write summary and footer."""
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
        self._end()

    def abandon(self) -> None:
        """Go back to the last flush, and finish the file if there is room for its summary."""
        try:
            if not self._output.is_at(self.path):
                raise FileExistsError(errno.EEXIST, "another file took its place")
            self._output.take_back()
            state = vars(self._writer)
            chunks, state[f"{OWN}statistics"] = self._flushed
            del state[f"{OWN}chunk_indices"][chunks:]
            state[f"{OWN}chunk_builder"].reset()
            state[f"{OWN}record_builder"].end()
            self._end()
        finally:
            self._output.close()

    def _end(self) -> None:
        self._writer.finish()
        self._output.flush()
        self._output.close()
