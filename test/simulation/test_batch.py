# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Batches: the bits of offline runs, whatever the block, the threads and the other valves."""

import numpy as np
import pytest

from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.simulation import batch, offline
from valve_control.parameter import defaults, updated

REAL = {
    "lvdt.noise": 0.0056,
    "lvdt.resolution": 0.0037,
    "friction.coulomb": 1.16,
    "friction.static_ratio": 1.25,
    "friction.stribeck_velocity": 0.017,
    "friction.presliding": 0.0033,
    "flow_force": 0.116,
    "gain_scale": 1.213,
}
STRONG = {"arc.robust_term": "quadratic", "oarc.robust_term": "quadratic"}
PLANTS = [
    {},
    REAL,
    {**REAL, "lvdt.delay": 0.0015, "drift.gain": 0.02},
    {**REAL, "friction.presliding": 0.0, "lvdt.bias": 0.1, "lvdt.resolution": 0.0},
    {"valve": "second_order", "lvdt.noise": 0.01, "lvdt.delay": 0.004, "drift.stiffness": 0.1},
]
SEEDS = [1, 2, 3, 4, 5, 1, 2, 3, 4, 5, 6]  # more than one block


def settings(i, controller):
    """Controller's and valve's values of valve ``i``."""
    changes = {
        "controller": controller,
        "arc.k1": 90.0 + i,
        "oarc.ks1": 80.0 + i,
        "dcarc.delay": 0.0004 * i,
        **(STRONG if i % 2 else {}),
    }
    return (
        updated(CONTROLLER, defaults(CONTROLLER), changes),
        updated(VALVE, defaults(VALVE), {**PLANTS[i % len(PLANTS)], "seed": SEEDS[i]}),
    )


def several(controller, samples):
    """Eleven different valves, each with its own command."""
    chosen = [settings(i, controller) for i in range(len(SEEDS))]
    shape = np.sin(np.arange(samples) * 0.02) + 0.2 * np.random.default_rng(2).standard_normal(samples)
    return chosen, batch.Batch(
        controller,
        batch.records([build.law_params(c) for c, _ in chosen]),
        batch.records([build.valve_params(v) for _, v in chosen]),
        SEEDS,
        np.clip(np.outer(0.5 + 0.7 * np.arange(len(SEEDS)), shape), -10.0, 10.0),
    )


@pytest.mark.parametrize("controller", ["arc", "oarc", "dcarc", "pid", "compensator", "open_loop"])
def test_every_valve_has_the_bits_and_indices_of_its_offline_run(controller):
    chosen, many = several(controller, 2500)
    traces = np.zeros((len(SEEDS), 2500, 3))
    results = batch.simulate(many, 2, traces)
    for i, (controller_values, valve_values) in enumerate(chosen):
        run = offline.simulate(controller_values, valve_values, many.commands[i])
        assert np.array_equal(traces[i, :, 0], run.position), i
        assert np.array_equal(traces[i, :, 1], run.measurement), i
        assert np.array_equal(traces[i, :, 2], run.voltage), i
        for name, value in run.indices._asdict().items():
            assert getattr(results, name)[i] == pytest.approx(value, rel=1e-12), (i, name)
        assert results.true_e_M[i] == run.true_error["e_M"]
        assert results.true_e_rms[i] == pytest.approx(run.true_error["e_rms"], rel=1e-12)
        assert results.saturated[i] == np.mean(np.abs(run.voltage) == 10.0)
        assert results.finite[i] == np.all(np.isfinite(run.measurement))
    assert np.any(results.saturated > 0.0) or controller == "open_loop"


def test_neither_threads_nor_neighbours_change_a_valve():
    _, many = several("oarc", 700)
    one, three = batch.simulate(many, 1), batch.simulate(many, 3)
    for a, b in zip(one, three, strict=True):
        assert np.array_equal(a, b, equal_nan=True)
    alone = batch.simulate(
        many._replace(
            law_params=many.law_params[7:8],
            valve_params=many.valve_params[7:8],
            seeds=[SEEDS[7]],
            commands=many.commands[7],
        )
    )
    for a, b in zip(one, alone, strict=True):
        assert np.array_equal(a[7:8], b, equal_nan=True)


def test_an_unstable_valve_is_told_and_spoils_no_other():
    _, many = several("arc", 1500)
    before = batch.simulate(many)
    many.valve_params["row0"]["x0"][3] = 1e3  # a linear part that explodes
    after = batch.simulate(many)
    assert not after.finite[3] and np.isnan(after.e_rms[3])
    others = np.arange(len(SEEDS)) != 3
    assert np.array_equal(before.e_rms[others], after.e_rms[others])
    assert np.all(after.finite[others])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"commands": np.zeros((50, 11))}, r"commands of 11 valves have shape \(n\) or \(11, n\), not"),
        ({"led": np.zeros((11, 49))}, "with their lead"),
        ({"controller": "oarc"}, "law_params must be valve_control.control.laws.oarc.Params"),
    ],
)
def test_batches_that_do_not_fit_together_are_refused(change, text):
    _, many = several("arc", 50)
    with pytest.raises(ValueError, match=text):
        batch.simulate(many._replace(**change))


def test_valves_of_one_batch_agree():
    _, many = several("arc", 50)
    many.law_params["u_max"][2] = 0.002
    with pytest.raises(ValueError, match="u_max differs"):
        batch.simulate(many)
    many.valve_params["period"][2] = 0.002
    with pytest.raises(ValueError, match="one sample"):
        batch.simulate(many)
