# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Plays a bag or a table to running nodes: publishes commands and positions of its valves at their times."""

import os
import signal
import sys
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64
from tqdm import tqdm

from valve_control.nodes.adapter import SAMPLES, encoded
from valve_control.nodes.transport import check_log_folder
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.recording import load

PLAYED = ("spool_command", "spool_position")
MEET = 10.0  # s to wait for somebody who listens
SETTLE = 0.5  # s in which discovery becomes mutual
DRAIN = 0.2  # s at the end, for what is still on its way


class Played(NamedTuple):
    """What was published, and how late."""

    published: int
    elapsed: float  # s
    late: float  # s, p99 of the delay behind the recorded time


def play(
    path: str,
    maps: Sequence[str],
    rate: float,
    start: float | None = None,
    end: float | None = None,
    quiet: bool = False,
    clock: str | None = None,
) -> Played:
    """Publish the commands and positions [V] of all valves at ``rate`` times the recorded speed.

    ``start``, ``end`` [s]: part of the bag. Raises BagError.
    """
    if not 0.001 <= rate <= 1000.0:
        raise BagError(f"--rate is {rate:g}; it must lie between 0.001 and 1000")
    signals = {
        f"{valve.topics.namespace}/{part}": valve.signals[part]
        for valve in load(path, maps, start, end, clock=clock).valves.values()
        for part in PLAYED
        if part in valve.signals
    }
    if not any(len(one.time) for one in signals.values()):
        raise BagError(f"{path} has neither commands nor positions")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    check_log_folder(os.environ)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("player")
    try:
        return _published(node, signals, rate, quiet)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _meet(publishers: dict[str, Any]) -> None:
    limit = time.monotonic() + MEET
    while missing := [name for name, one in publishers.items() if one.get_subscription_count() == 0]:
        if time.monotonic() > limit:
            raise BagError(
                f"nobody has listened to {', '.join(missing)} for {MEET:g} s; is the controller running?"
            )
        time.sleep(0.02)
    time.sleep(SETTLE)


def _published(node: Node, signals: dict[str, Any], rate: float, quiet: bool) -> Played:
    publishers = {topic: node.create_publisher(Float64, topic, SAMPLES) for topic in signals}
    times = np.concatenate([one.time for one in signals.values()])
    order = np.lexsort((np.concatenate([one.place for one in signals.values()]), times))
    messages = [(publishers[topic], value) for topic, one in signals.items() for value in one.value.tolist()]
    _meet(publishers)
    due = ((times[order] - times[order[0]]) * 1e-9 / rate).tolist()
    delays = []
    began = time.monotonic()
    with tqdm(total=due[-1], unit="s", disable=quiet, ascii=not sys.stderr.isatty(), mininterval=1.0,
              bar_format="live {bar} {n:.1f}/{total:.1f} s") as progress:  # fmt: skip
        for moment, i in zip(due, order.tolist(), strict=True):
            pause = began + moment - time.monotonic()
            if pause > 0.0:
                time.sleep(pause)
            publisher, value = messages[i]
            publisher.publish(encoded(value))
            delays.append(time.monotonic() - began - moment)
            if moment - progress.n >= 0.1:
                progress.update(moment - progress.n)
        progress.update(due[-1] - progress.n)
    elapsed = time.monotonic() - began
    time.sleep(DRAIN)
    return Played(len(due), elapsed, float(np.percentile(delays, 99)))
