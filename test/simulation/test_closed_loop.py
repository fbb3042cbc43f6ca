# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The promises: bandwidth, no chatter, equal bits, cost."""

import numpy as np
import pytest

from valve_control.control.laws import registry
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND
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
