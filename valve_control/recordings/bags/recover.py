# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes a finished copy of a bag whose recorder was killed or whose files are damaged: `bag recover`."""

import shutil
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.sqlite_reader import SALVAGE
from valve_control.recordings.bags.writer import BagWriter


class Recovered(NamedTuple):
    """What recovery has found, and written."""

    bag: Path
    out: Path | None  # the finished copy; None: the bag is whole, or has no message
    messages: int
    lost: int | None  # messages of metadata.yaml that could not be read; None: it does not tell
    damaged_chunks: int  # of MCAP files, that are left out
    problems: list[str]  # of the bag


def recover(path: Path, out: Path | None = None) -> Recovered:
    """Copy all messages of the bag ``path`` that can be read into a new, finished bag ``out``.

    Nothing is written of a bag without a problem. The bag itself stays as it is. Raises BagError.
    """
    with closing(Bag(path)) as bag:
        if bag.table is not None:
            raise BagError(f"{path} is a table; only bags are recovered")
        count = sum(len(block.topic) for _, block in bag.blocks(bag.topics))
        if bag.damaged and bag.storage == "sqlite3":
            raise BagError(f"{path} is damaged; {SALVAGE}")
        listed = bag.listing.message_count
        lost = None if bag.listing.version is None else max(0, listed - count)
        if lost:
            bag.problems.append(f"metadata.yaml names {listed} messages, the files hold {count}")
        whole = count == 0 or not bag.problems
        place = path if path.name.strip(".") else path.resolve()
        beside = place.with_name(f"{place.name if place.is_dir() else place.stem}_recovered")
        target = None if whole else _copied(bag, out or beside)
        return Recovered(path, target, count, lost, bag.damaged, bag.problems)


def _copied(bag: Bag, out: Path) -> Path:
    """Write all messages of ``bag`` into the new bag ``out``."""
    if out.resolve().is_relative_to(bag.path.resolve()):
        raise BagError(f"{out} lies in {bag.path}; the copy needs a place of its own")
    writer = BagWriter(out, bag.storage)
    try:
        for topic in bag.topics.values():
            writer.add_topic(
                topic.name, topic.type, topic.definition, topic.type_hash, metadata.profiles(topic.qos),
                topic.definition_format,
            )  # fmt: skip
        for topic_name, log, publish, sequence, data in bag.in_file_order():
            writer.write(topic_name, log, publish, sequence, data)
        writer.close()
    except BaseException:  # Ctrl-C too
        shutil.rmtree(out, ignore_errors=True)
        raise
    return out
