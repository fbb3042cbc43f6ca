# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.coil``: dcarc on three solenoid valves, with more and more of the magnet in the law.

The model is the valve's own, motions are known ahead, the gains are the same on all valves. Prints the table
of docs/explanation/laws/dcarc.md as Markdown.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from research import running
from valve_control.cli.common import write_json

if TYPE_CHECKING:
    from valve_control.parameter import Values


class CoilValve(NamedTuple):
    """What differs between the valves."""

    frequency: float  # Hz
    damping: float  # -
    coil: float  # s
    hysteresis: float  # V  full width
    coulomb: float  # V


GAIN, SIDE = 0.9, 1.1  # V/V and -: gain of one side, and times as much on the other
VALVES = {
    "A": CoilValve(9.0, 0.8, 0.004, 0.2, 0.5),
    "B": CoilValve(35.0, 0.7, 0.0015, 0.2, 0.4),
    "C": CoilValve(7.0, 0.9, 0.003, 0.1, 1.2),
}
TERMS = ("dcarc.coil", "dcarc.hysteresis", "dcarc.sides")
LAWS = ("coil in the model, disturbance a voltage", *TERMS)
ALONE = "the same, command alone"
FAST = 700.0  # rad/s  natural frequency of the reshaping for a command alone


class Measured(NamedTuple):
    """One law on one valve."""

    error: float  # V  geometric mean of the true e_rms on the motions
    chatter: float  # -  mean c_u


def plant(valve: CoilValve) -> "Values":
    """Values of the simulator for ``valve``."""
    from valve_control.control.parameters.table import VALVE
    from valve_control.parameter import defaults, updated

    own = {
        "valve": "solenoid",
        "solenoid.natural_frequency": valve.frequency,
        "solenoid.damping": valve.damping,
        "solenoid.coil": valve.coil,
        "solenoid.hysteresis": valve.hysteresis,
        "solenoid.gain": GAIN,
        "solenoid.positive": SIDE,
        "solenoid.bits": 12,
        "solenoid.hum": 0.003,
        "lvdt.noise": 0.003,
        "lvdt.resolution": 0.0,
        "flow_force": 0.05,
        "disturbance.offset": 0.1,
        "friction.coulomb": valve.coulomb,
        "friction.static_ratio": 1.3,
        "friction.stribeck_velocity": 0.02,
        "friction.presliding": 0.02,
    }
    return updated(VALVE, defaults(VALVE), own)


def controller(valve: CoilValve, terms: Sequence[str]) -> "Values":
    """Values of dcarc that knows ``valve``, with those of TERMS that are in ``terms``."""
    import numpy as np

    from research.comparison import NO_LIMITS
    from valve_control.control.parameters.table import CONTROLLER
    from valve_control.parameter import defaults, updated

    w, gain = 2.0 * math.pi * valve.frequency, 0.5 * (1.0 + SIDE) * GAIN
    known = {"dcarc.coil": valve.coil, "dcarc.hysteresis": 0.5 * valve.hysteresis, "dcarc.sides": SIDE - 1.0}
    own = {
        **NO_LIMITS,
        "controller": "dcarc",
        "dcarc.model": "custom",
        "dcarc.numerator": [gain * w * w],
        "dcarc.denominator": np.polymul([1.0, 2.0 * valve.damping * w, w * w], [valve.coil, 1.0]).tolist(),
        "dcarc.lvdt_noise": 0.004,
        "dcarc.lvdt_resolution": 0.0049,
        "dcarc.input_noise": 0.5,
        "dcarc.disturbance_rate": 4.0,
        "dcarc.voltage_weight": 0.02,
        "dcarc.presliding": [0.008, 0.02, 0.05],
        "dcarc.theta_initial": [0.0, 0.0, valve.coulomb, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        "dcarc.theta_spread": [0.1, 0.15, 0.15, 0.15, 0.15, 0.1, 0.2, 0.0, 0.0],
        "dcarc.fit_noise": 0.4,
        "dcarc.forgetting": 0.05,
        **{term: known[term] for term in terms},
    }
    return updated(CONTROLLER, defaults(CONTROLLER), own)


def led(values: "Values") -> "Values":
    """``values`` with a fast reshaping, and the lead that makes up for all of its lag."""
    from valve_control.control.laws import dcarc, reshaping
    from valve_control.control.parameters.table import CONTROLLER
    from valve_control.parameter import updated

    fast = updated(CONTROLLER, values, {"reshaping.natural_frequency": FAST, "reshaping.lead_accel": 1.0})
    lag = reshaping.lag(fast) + 1.0 / dcarc.build(fast).reshaping.smoothing
    return updated(CONTROLLER, fast, {"reshaping.lead": lag})


def measured(
    valve: CoilValve, terms: Sequence[str], motions: Sequence[str] = (), alone: bool = False
) -> Measured:
    """Run dcarc with ``terms`` on ``valve`` and the ``motions`` of ``compare``; (): all of them.

    ``alone``: they are not known ahead.
    """
    import numpy as np

    from research import comparison
    from valve_control.control.analysis.indices import rms
    from valve_control.control.laws import dcarc
    from valve_control.control.simulation import delivery, offline

    values = led(controller(valve, terms)) if alone else controller(valve, terms)
    p = dcarc.build(values)
    errors, chatter = [], []
    for name, wanted in comparison.motions().items():
        if motions and name not in motions:
            continue
        sent = wanted[:-2] if alone else delivery.unreshaped(p.reshaping, wanted)
        run = offline.simulate(values, plant(valve), sent)
        errors.append(rms(run.position - wanted[:-2]))
        chatter.append(run.indices.c_u)
    return Measured(float(np.exp(np.mean(np.log(errors)))), float(np.mean(chatter)))


def table(found: Sequence[Sequence[Measured]]) -> list[str]:
    """Markdown with one row for each of LAWS, one column for each of VALVES: e_rms in mV and c_u."""
    lines = [f"| law | {' | '.join(VALVES)} |", "|---" * (len(VALVES) + 1) + "|"]
    names = [LAWS[0], f"`{LAWS[1]}`", *(f"with `{term}` too" for term in LAWS[2:]), ALONE]
    for name, row in zip(names, found, strict=True):
        lines.append(
            f"| {name} | " + " | ".join(f"{1e3 * m.error:.1f} ({m.chatter:.2f})" for m in row) + " |"
        )
    return lines


def _coil(arguments: argparse.Namespace) -> None:
    found = [[measured(valve, TERMS[:i]) for valve in VALVES.values()] for i in range(len(LAWS))]
    found.append([measured(valve, TERMS, alone=True) for valve in VALVES.values()])
    if arguments.json != "-":
        print("\n".join(table(found)))
    rows = [{name: m._asdict() for name, m in zip(VALVES, row, strict=True)} for row in found]
    write_json(arguments, dict(zip((*LAWS, ALONE), rows, strict=True)))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement; returns the exit status."""
    options = running.options(
        "coil", "dcarc on three solenoid valves, with more and more of the magnet in the law."
    )
    return running.run(options, _coil, argv)


if __name__ == "__main__":
    sys.exit(main())
