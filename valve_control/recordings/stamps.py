# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Times of messages by the stamps in their headers, or by a simulated clock that was recorded."""

from collections.abc import Mapping, Sequence

import numpy as np

from valve_control.arrays import Integers
from valve_control.recordings.bags.bag import Bag, Series
from valve_control.recordings.bags.cdr import Decoder
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.clocks import Clock

HEADER = "header"
SIMULATED = "/clock"
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
TIME = ("clock.sec", "clock.nanosec")  # of rosgraph_msgs/Clock


def fields(bag: Bag, topics: Sequence[str], wanted: str | None) -> dict[str, tuple[str, str]]:
    """What is to be read beside the signals on ``topics`` for the ``wanted`` clock. Raises BagError."""
    if wanted == SIMULATED:
        if SIMULATED not in bag.topics or not _has(bag, SIMULATED, TIME):
            raise BagError(f"--clock {SIMULATED}: {bag.path} has no {SIMULATED} (rosgraph_msgs/Clock)")
        return {SIMULATED: TIME}
    if wanted != HEADER:
        return {}
    stamped = {name: STAMP for name in dict.fromkeys(topics) if _has(bag, name, STAMP)}
    if not stamped:
        told = ", ".join(f"{name} ({bag.topics[name].type})" for name in dict.fromkeys(topics))
        raise BagError(f"--clock {HEADER}: {bag.path} has no signal with a header; it has {told}")
    return stamped


def _has(bag: Bag, topic: str, names: tuple[str, str]) -> bool:
    """Whether a message of ``topic`` has the two numbers."""
    message = bag.first(topic)
    if message is None:
        return False
    try:
        Decoder(bag.topic(topic), names).layout(message)
    except BagError:
        return False
    return True


def retimed(
    series: Mapping[str, Series],
    stamped: Mapping[str, tuple[str, str]],
    usual: Clock,
    signals: Sequence[str],
) -> tuple[dict[str, Series], Clock]:
    """``series`` whose publish_time is that of the clock of ``stamped``, and this clock.

    Messages of topics that are not ``stamped`` have the time of that clock at the time of recording; between
    two messages of /clock, and of times of sending where the ``usual`` clock is theirs. Raises BagError.
    """
    simulated = SIMULATED in stamped
    source = simulated and usual.source
    known = {name: _stamps(series[name], names) for name, names in stamped.items()}
    for name, time in known.items():
        if not len(time) or not np.any(time):
            raise BagError(f"--clock: the stamps on {name} are 0")
    longest = max(known, key=lambda name: len(known[name]))
    reference = series[longest].publish_time if source else series[longest].log_time
    order = np.argsort(reference, kind="stable")
    moments, offset = reference[order], (known[longest] - reference)[order]
    moved = {}
    for name, one in series.items():
        if name in known:
            moved[name] = one._replace(publish_time=known[name])
            continue
        carrier = one.publish_time if source else one.log_time
        ahead = np.interp(
            (carrier - moments[0]).astype(np.float64),
            (moments - moments[0]).astype(np.float64),
            (offset - offset[0]).astype(np.float64),
        )
        moved[name] = one._replace(publish_time=carrier + offset[0] + np.round(ahead).astype(np.int64))
    notes = [
        f"{name} has no header; its times are those of recording, moved to the clock of the headers"
        for name in dict.fromkeys(signals)
        if not simulated and name not in known
    ]
    return moved, Clock(SIMULATED if simulated else "header.stamp", np.nan, np.nan, tuple(notes))


def _stamps(series: Series, names: tuple[str, str]) -> Integers:
    seconds, nanoseconds = (series.values[name].astype(np.int64) for name in names)
    return np.asarray(seconds * 10**9 + nanoseconds, dtype=np.int64)
