# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Dry run of a device: opens it, reads for a while, and tells noise, rate and losses; writes nothing."""

import math
import time
from typing import NamedTuple

import numpy as np

from valve_control.control.drivers.device import Device

SECONDS = 2.0


class Trial(NamedTuple):
    """The readings of a dry run."""

    volts: list[float]  # NaN: the device or the limits call it invalid
    times: list[float]  # s, of each
    lost: int
    conditions: dict[str, str]  # sentence by name, of all that came


def run(device: Device, seconds: float = SECONDS) -> Trial:
    """Open ``device``, read for ``seconds``, close it. Raises DriverError if it cannot be opened."""
    device.open()
    volts, times, conditions = [], [], {}
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            reading = device.read()
            conditions.update({condition.name: condition.text for condition in device.conditions()})
            if reading is not None:
                volts.append(reading.signal)
                times.append(time.monotonic())
    finally:
        device.close()
    return Trial(volts, times, device.lost, conditions)


def noise(volts: list[float]) -> float:
    """Standard deviation [V] of white noise on any slow motion: second differences have √6 times as much."""
    differences = np.diff(volts, 2)
    return float(np.sqrt(np.mean(differences**2) / 6.0)) if len(differences) else math.nan


def told(trial: Trial, device: Device, period: float) -> list[str]:
    """Lines about a dry run with readings; ``period``: sample period [s] that is expected."""
    sound = [value for value in trial.volts if math.isfinite(value)]
    scale = device.position.scale
    wrong = len(trial.volts) - len(sound)
    lines = [f"readings   {len(trial.volts)}, of which {wrong} not valid; {trial.lost} lost"]
    if len(trial.times) > 1:
        periods = np.diff(trial.times)
        mean = (trial.times[-1] - trial.times[0]) / (len(periods) + trial.lost)
        lines.append(
            f"rate       {1.0 / mean:.2f} Hz; the period is {100.0 * (mean / period - 1.0):+.2f} % off "
            f"sample_period; largest gap {1e3 * np.max(periods):.3g} ms"
        )
    if sound:
        mean = float(np.mean(sound))
        lines += [
            f"position   {mean:.4f} V on average, {min(sound):.4f} to {max(sound):.4f} V; "
            f"signal {scale.signal(mean):.6g} on average",
            f"noise      {1e3 * noise(sound):.3g} mV (standard deviation, from second differences)",
        ]
    return lines + [f"{name}: {text}" for name, text in trial.conditions.items()]
