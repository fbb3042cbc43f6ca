# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A run says when it saturates and cycles; the check of the gains looks at the valve that is simulated."""

import json
import math

import numpy as np
import pytest

from valve_control.control.laws import pid
from valve_control.control.linear import stability
from valve_control.control.parameters import build
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


@pytest.mark.parametrize(
    ("file", "controller", "frequency"),
    [("arc", "arc", 66.0), ("oarc", "oarc", 47.0), ("pid_plain", "pid", 57.0)],
)
def test_simulate_says_saturation_and_limit_cycle(run, config, file, controller, frequency):
    arguments = [
        "simulate", "--params-file", config / f"{file}.yaml", *settings_of_third_order(),
        "--scenario", "step", "--set", "amplitude=0.3", "--duration", "3.0",
    ]  # fmt: skip
    result = json.loads(run(*arguments, "--json", "-").out)
    assert result["controller"] == controller
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
@pytest.mark.parametrize("plant", ["second_order", "fourth_order", "d3fxe"])
def test_shipped_laws_on_shipped_valves_neither_cycle_nor_warn(config, file, plant, simulate):
    from valve_control.control.parameters import files
    from valve_control.control.simulation import offline

    names = [f"{file}.yaml", *(["d3fxe.yaml"] if plant == "d3fxe" else [])]
    changes = files.given([str(config / name) for name in names], {}, [])
    law = updated(CONTROLLER, defaults(CONTROLLER), changes["controller"])
    valve = updated(VALVE, defaults(VALVE), changes["valve_simulator"])
    if plant != "d3fxe":
        valve = updated(VALVE, valve, {"valve": plant})
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


def test_pole_around_a_valve_with_dead_time_is_that_of_the_loop_written_out():
    """Proportional control of the second-order valve with a reading that is two samples late."""
    import scipy.signal

    changes = {
        "pid.form": "plain",
        "pid.kp": 6.0,
        "pid.ki": 0.0,
        "pid.kd": 0.0,
        "pid.static_feedforward": 0.0,
    }
    p = pid.build(updated(CONTROLLER, defaults(CONTROLLER), changes))
    plant = build.valve_params(
        updated(
            VALVE,
            defaults(VALVE),
            {"valve": "second_order", "lvdt.delay": 0.002, "gain_scale": 5.0, "flow_force": 0.1},
        )
    )
    gain = 5.0 * 1502.057
    a, b, _, _, _ = scipy.signal.cont2discrete(
        (
            np.array([[0.0, 1.0], [-1657.206, -58.771]]),
            np.array([[0.0], [gain]]),
            np.eye(1, 2),
            np.zeros((1, 1)),
        ),
        0.001,
    )
    late = np.zeros((4, 4))  # position, velocity, and the position one and two samples ago
    late[:2, :2] = a - b @ np.array([[0.1, 0.0]])  # the flow force is held over the period too
    late[:2, 3:] = -6.0 * b
    late[2, 0] = late[3, 2] = 1.0
    expected = np.max(np.abs(np.linalg.eigvals(late)))
    assert expected > 1.0
    assert abs(stability.dominant_pole(pid.LAW, p, plant)) == pytest.approx(expected, rel=1e-6)
