# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.fieldbus``: the sample periods that the drivers of field buses keep on this machine.

Each run exchanges readings and voltages with a device of test/drivers in another process: CANopen behind an
slcan adapter on a pseudo-terminal, Modbus on loopback. Jitter is how far the time between two readings is
from the period. Prints tables as Markdown; docs/howto/canopen.md and docs/howto/modbus.md have parts.
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from research.campaigns.drivers import KINDS, device
from valve_control.control.parameters import drivers
from valve_control.control.parameters.drivers import DEVICE
from valve_control.control.parameters.ros_file import from_text
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import Values, defaults, lookup, updated

SECONDS = 4.0  # of each run
PERIODS = {"canopen": (0.01, 0.005, 0.002, 0.001), "modbus": (0.02, 0.01, 0.005, 0.002, 0.001)}  # s
AMPLITUDE, FREQUENCY = 1.0, 2.0  # V, Hz  of the voltage
BEGIN = 0.5  # s  that do not count
HEADS = ("period", "mean", "jitter, median", "jitter, 99 %", "jitter, largest", "readings lost", "processor")


class Kept(NamedTuple):
    """A run; times in s."""

    mean: float
    jitter_50: float
    jitter_99: float
    largest: float
    lost: int
    ticks: int
    processor: float  # share of a core that this process took


def values_of(kind: str, address: str, period: float) -> Values:
    """Parameters of a driver for the device at ``address``."""
    table = (*CONTROLLER, *DEVICE)
    given = [setting.split(":=") for setting in (*KINDS[kind].settings, f"{KINDS[kind].address}:={address}")]
    changes = {name: from_text(lookup(table, name), word) for name, word in given}
    return updated(table, defaults(table), {**changes, "driver": kind, "sample_period": period})


def run(kind: str, period: float, seconds: float) -> Kept:
    """Exchange a slow voltage and readings for ``seconds``. Raises DriverError."""
    words = tuple(f"{period:g}" if word == f"{KINDS[kind].period:g}" else word for word in KINDS[kind].words)
    times: list[float] = []
    lost, used = 0, 0.0
    with device(KINDS[kind]._replace(words=words)) as there:
        made = drivers.device(values_of(kind, there.address, period))
        made.open()
        try:
            made.enable(True)
            begin = time.monotonic() + BEGIN
            while not times or times[-1] < begin + seconds:
                reading = made.read()
                now = time.monotonic()
                made.write(AMPLITUDE * math.sin(2.0 * math.pi * FREQUENCY * now))
                if now < begin:
                    lost, used = made.lost, time.process_time()
                elif reading is not None:
                    times.append(now)
            lost, used = made.lost - lost, time.process_time() - used
        finally:
            made.close()
    gaps = np.diff(times)
    jitter = np.abs(gaps - period)
    elapsed = times[-1] - times[0]
    half, most = np.quantile(jitter, (0.5, 0.99))
    return Kept(
        elapsed / len(gaps), half, most, float(np.max(jitter)), lost, round(elapsed / period), used / elapsed
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bus", choices=sorted(PERIODS), action="append", help="this one only")
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"of each run ({SECONDS:g})")
    options = parser.parse_args(arguments)
    for kind in options.bus or PERIODS:
        print(f"\n{kind}\n")
        print("| " + " | ".join(HEADS) + " |")
        print("|---" * len(HEADS) + "|")
        for period in PERIODS[kind]:
            k = run(kind, period, options.seconds)
            cells = [f"{1e3 * period:g} ms", f"{1e3 * k.mean:.3f} ms"]
            cells += [f"{1e3 * jitter:.2f} ms" for jitter in (k.jitter_50, k.jitter_99, k.largest)]
            cells += [f"{k.lost} of {k.ticks}", f"{100.0 * k.processor:.0f} %"]
            print("| " + " | ".join(cells) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
