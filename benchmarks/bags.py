# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reading a bag column by column against a plain rosbags loop over it, and what an analysis takes."""

import resource
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from tqdm import tqdm

from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.writer import BagWriter

FLOAT = "std_msgs/msg/Float64"
TOPICS = ("/spool_command", "/spool_position", "/valve_voltage", "/pump_pressure")
RATIOS = {"mcap": 20.0, "sqlite3": 2.0}  # wanted, times as fast as the plain loop
MEMORY = 1.5  # GiB
WANTED = {
    "bag_vs_rosbags": ("at least", RATIOS["mcap"]),
    "bag_vs_rosbags_sqlite3": ("at least", RATIOS["sqlite3"]),
    "analyze_memory_gib": ("at most", MEMORY),
}


def make_bag(folder: Path, storage: str, seconds: float) -> Path:
    """A bag of ``seconds`` at 1 kHz on four topics."""
    store = get_typestore(Stores.ROS2_JAZZY)
    text, _ = store.generate_msgdef(FLOAT, ros_version=2)
    count = round(seconds * 1000)
    random = np.random.default_rng(1)
    with BagWriter(folder, storage) as writer, tqdm(total=count, desc=f"writing {storage}", ascii=True,
                                                    mininterval=5.0) as progress:  # fmt: skip
        for topic in TOPICS:
            writer.add_topic(topic, FLOAT, text, store.hash_rihs01(FLOAT))
        for block in range(0, count, 1000):
            k = np.arange(block, min(block + 1000, count))
            command = 2.0 * np.sin(2.0 * np.pi * 1e-3 * k)
            reading = command + 0.02 * random.standard_normal(len(k))
            rows = np.stack([command, reading, 1.2 * reading, 0.1 * reading], axis=1).tolist()
            for i, row in zip(k.tolist(), rows, strict=True):
                for j, value in enumerate(row):
                    sent = 1_790_000_000_000_000_000 + i * 1_000_000 + j * 150_000
                    data = b"\0\1\0\0" + struct.pack("<d", value)
                    writer.write(TOPICS[j], sent + 100_000, sent, i + 1, data)
            progress.update(len(k))
    return folder


def plain_loop(folder: Path) -> tuple[float, int]:
    """Seconds and messages of a loop that deserialises every message with rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    began, count, total = time.perf_counter(), 0, 0.0
    with Reader(folder) as reader:
        for connection, _, data in reader.messages():
            message: Any = store.deserialize_cdr(data, connection.msgtype)
            total += message.data
            count += 1
    return time.perf_counter() - began, count


def columns(folder: Path) -> tuple[float, int]:
    """Seconds and messages of reading the same into columns."""
    began = time.perf_counter()
    series = Bag(folder).read({topic: ["data"] for topic in TOPICS})
    return time.perf_counter() - began, sum(len(entry.log_time) for entry in series.values())


def run(folder: Path, seconds: float) -> dict[str, Any]:
    """Measure both storages with bags of ``seconds``; a table, and the figures for JSON."""
    results: dict[str, Any] = {}
    columns(make_bag(folder / "warm_up", "mcap", 1.0))  # compiles
    print(
        f"{'':10}{'messages':>10}{'plain loop [s]':>16}{'columns [s]':>13}{'ratio':>8}{'wanted':>8}", end=""
    )
    print(f"{'analyze [s]':>13}{'memory [GiB]':>14}")
    for storage, wanted in RATIOS.items():
        bag = make_bag(folder / storage, storage, seconds)
        passes = [columns(bag) for _ in range(3)]
        fast, count = sorted(passes)[1]
        slow, same = plain_loop(bag)
        assert count == same
        began = time.perf_counter()
        report = ["--html", str(folder / "report.html"), "--json", str(folder / "report.json")]
        subprocess.run(
            [sys.executable, "-m", "valve_control.cli", "analyze", str(bag), *report],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        took = time.perf_counter() - began
        memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
        results[storage] = {
            "messages": count,
            "plain_loop_s": slow,
            "columns_s": fast,
            "columns_each_s": [seconds for seconds, _ in passes],
            "ratio": slow / fast,
            "wanted_ratio": wanted,
            "analyze_s": took,
            "analyze_peak_memory_gib": memory,
            "wanted_memory_gib": MEMORY,
        }
        print(f"{storage:10}{count:10d}{slow:16.2f}{fast:13.2f}{slow / fast:8.1f}{wanted:8.0f}", end="")
        print(f"{took:13.1f}{memory:14.2f}")
    figures = {
        "bag_vs_rosbags": results["mcap"]["ratio"],
        "bag_vs_rosbags_sqlite3": results["sqlite3"]["ratio"],
        "analyze_memory_gib": max(entry["analyze_peak_memory_gib"] for entry in results.values()),
    }
    return {**results, "figures": figures}
