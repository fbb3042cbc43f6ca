# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Offline runs: equal bits, what they say of saturation, limit cycles and the gains."""

import json

import numpy as np
import pytest
from changed import THIRD_ORDER

from valve_control.control.laws import registry
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND, CONTROLLER, VALVE
from valve_control.control.simulation import offline
from valve_control.parameter import defaults, updated

LAWS = tuple(registry.LAWS)
REAL = {
    "lvdt.noise": 0.005,
    "lvdt.resolution": 0.003,
    "lvdt.delay": 0.0015,
    "friction.coulomb": 0.7,
    "friction.static_ratio": 1.3,
    "flow_force": 0.1,
    "drift.gain": 0.02,
}


def test_a_reference_that_is_cut_although_the_valve_could_follow_is_said(simulate):
    """A valve of 100 Hz with the limits of the D3FXE; with (6) and (7) of its own nothing is said."""
    valve = {"valve": "custom", "numerator": [394784.0], "denominator": [1.0, 1005.3, 394784.0]}
    command = np.where(np.arange(400) % 100 < 50, 0.0, 1.0)
    run = simulate("pid", command, valve=valve)
    assert "reshaping.max_accel 12000 cuts the reference in" in run.warning
    assert "3.948e+06" in run.warning
    own = {"reshaping.max_accel": 3.948e6, "reshaping.max_rate": 3927.0}
    assert "cuts the reference" not in simulate("pid", command, valve=valve, **own).warning


def trajectory(period=0.001):
    return build.commands(updated(COMMAND, defaults(COMMAND), {"sample_period": period}))


@pytest.mark.parametrize(
    ("controller", "changes"),
    [(law, {}) for law in LAWS]
    + [
        ("arc", {"arc__robust_term": "quadratic"}),
        ("oarc", {"oarc__robust_term": "quadratic", "oarc__epsilon1": 5e4, "oarc__epsilon2": 5e4}),
        ("pid", {"pid__form": "reference"}),
        ("pid", {"pid__form": "plain"}),
        ("compensator", {"compensator__design": "designed"}),
    ],
)
def test_python_and_compiled_steps_give_the_same_bits(simulate, controller, changes):
    command = trajectory()[:1500] + np.random.default_rng(2).normal(size=1500)
    compiled = simulate(controller, command, valve=REAL, **changes)
    plain = simulate(controller, command, compiled=False, valve=REAL, **changes)
    assert np.array_equal(compiled.voltage, plain.voltage)
    assert np.array_equal(compiled.position, plain.position)
    for label, values in compiled.terms.items():
        assert np.array_equal(values, plain.terms[label]), label
    assert np.ptp(compiled.voltage) > 0.1


@pytest.mark.parametrize("controller", ["oarc", "dcarc"])
def test_a_run_in_pieces_has_the_bits_of_one(simulate, monkeypatch, controller):
    command = trajectory()[:2500]
    whole = simulate(controller, command, valve=REAL)
    monkeypatch.setattr(offline, "PIECE", 700)
    pieces = simulate(controller, command, valve=REAL)
    for name in ("position", "measurement", "voltage"):
        assert np.array_equal(getattr(whole, name), getattr(pieces, name))
    assert all(np.array_equal(whole.terms[name], pieces.terms[name]) for name in whole.terms)
    assert whole.theta == pieces.theta


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
