# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Commands of an upper level of 100 Hz: where joining them helps, and where it does not."""

import numpy as np
import pytest

from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.control.simulation.delivery import Delivery
from valve_control.parameter import defaults, updated

SETTLED = 1000  # samples


def values(node, path=None, **changes):
    base = {**defaults(NODES[node]), **(files.load(str(path))[node] if path else {})}
    return updated(NODES[node], base, changes)


def error(config, kind, frequency):
    """True rms error [mV] on a sine of 1 V, with the commands at 100 Hz."""
    law = values("controller", config / "dcarc.yaml", **{"command.interpolation": kind})
    shape = {"scenario": "sine", "frequency": frequency, "amplitude": 1.0, "duration": 3.0, "start": 0.0}
    command = build.commands(values("command_source", **shape))
    simulated = values("valve_simulator", config / "d3fxe.yaml")
    run = offline.simulate(law, simulated, command, delivered=Delivery(0.01))
    return 1e3 * float(np.sqrt(np.mean((run.position - command)[SETTLED:] ** 2)))


@pytest.mark.parametrize(
    ("frequency", "hold", "linear", "extrapolate", "bridge"),
    [(1.0, 44.0, 72.0, 26.0, 24.1), (3.0, 139.0, 214.0, 96.0, 67.9), (10.0, 447.0, 665.0, 594.0, 74.5)],
)
def test_errors_at_100_hz_are_those_of_the_table(config, frequency, hold, linear, extrapolate, bridge):
    """Of docs/howto/cascade.md."""
    found = [error(config, kind, frequency) for kind in ("hold", "linear", "extrapolate", "bridge")]
    assert found == pytest.approx([hold, linear, extrapolate, bridge], rel=0.02)
