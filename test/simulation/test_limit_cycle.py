# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A run says when it saturates and cycles; the check of the gains looks at the valve that is simulated."""

import json
import math

import numpy as np
import pytest

from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.parameter import defaults, updated

W = 2.0 * math.pi * 12.0
# 12 Hz with a damping of 0.9, and a pole at 60 Hz.
DENOMINATOR = np.polymul([1.0, 2.0 * 0.9 * W, W * W], [1.0 / (2.0 * math.pi * 60.0), 1.0]).tolist()
THIRD_ORDER = {
    "valve": "custom", "numerator": [1.3 * W * W], "denominator": DENOMINATOR, "friction.coulomb": 0.6,
    "lvdt.noise": 0.008, "lvdt.delay": 0.0004,
}  # fmt: skip


def settings_of_third_order():
    return [part for name, value in THIRD_ORDER.items() for part in ("--set", f"{name}={value}")]


def test_simulate_says_saturation_and_limit_cycle(run, config, controller="oarc", frequency=47.0):
    arguments = [
        "simulate", "--params-file", config / f"{controller}.yaml", *settings_of_third_order(),
        "--scenario", "step", "--set", "amplitude=0.3", "--duration", "3.0",
    ]  # fmt: skip
    result = json.loads(run(*arguments, "--json", "-").out)
    assert 0.3 < result["saturated"] < 1.0
    cycle = result["limit_cycle"]
    assert cycle["frequency"] == pytest.approx(frequency, rel=0.05)
    assert cycle["amplitude"] == pytest.approx(10.0, abs=0.2)
    assert cycle["start"] < 0.5 and cycle["end"] > 2.9
    assert f"{controller} with these gains is unstable on this valve" in result["warning"]
    done = run(*arguments)
    assert "unstable on this valve" in done.err
    line = next(line for line in done.out.splitlines() if line.startswith(f"{controller}: saturated in"))
    assert "% of the samples, limit cycle at" in line and "Hz with 10 V from" in line


@pytest.mark.parametrize("file", ["arc", "oarc", "pid", "pid_plain", "compensator", "open_loop"])
def test_shipped_laws_on_the_shipped_valve_neither_cycle_nor_warn(config, file):
    from valve_control.control.parameters import files
    from valve_control.control.simulation import offline

    changes = files.given([str(config / name) for name in (f"{file}.yaml", "d3fxe.yaml")], {}, [])
    law = updated(CONTROLLER, defaults(CONTROLLER), changes["controller"])
    valve = updated(VALVE, defaults(VALVE), changes["valve_simulator"])
    run = offline.simulate(law, valve, np.where(np.arange(2000) < 250, 0.0, 1.0))
    assert run.warning == "" and run.limit_cycle is None


@pytest.mark.parametrize(("controller", "gain"), [("arc", 0.45), ("oarc", 0.6)])
def test_loop_that_only_a_larger_motion_brings_into_a_limit_cycle(simulate, controller, gain):
    """Stable poles at rest; a step moves the estimates to where there are none. The run has no motion."""
    valve = {**THIRD_ORDER, "gain_scale": gain, "friction.coulomb": 0.0, "lvdt.noise": 0.0, "lvdt.delay": 0.0}
    changes = {"arc__velocity_cutoff": 100.0}
    still = simulate(controller, np.zeros(500), valve=valve, **changes)
    assert still.limit_cycle is None
    assert still.warning.startswith(
        f"on this valve a step of 0.3 V brings {controller} into a limit cycle at"
    )
    moved = simulate(controller, np.where(np.arange(2000) < 250, 0.0, 0.3), valve=valve, **changes)
    assert moved.limit_cycle is not None and moved.limit_cycle.end > 1.9
