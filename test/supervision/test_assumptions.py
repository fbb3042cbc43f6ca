# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The monitors of V2 and of dcarc's burden: silent in ordinary use, find a valve that leaves its ranges."""

import numpy as np
import pytest
from test_cycle_watch import PERIOD, Loop

from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER, NODES, VALVE
from valve_control.control.plant.transfer_functions import FOURTH_ORDER
from valve_control.control.simulation import offline
from valve_control.parameter import defaults, updated


def settings(config, law, names, **source):
    changes = files.given([str(config / name) for name in names], {}, [])
    made = {node: updated(table, defaults(table), changes[node]) for node, table in NODES.items()}
    made["controller"] = updated(CONTROLLER, made["controller"], {"controller": law})
    made["command_source"] = updated(NODES["command_source"], made["command_source"], source)
    return made


ORDINARY = [
    ("oarc", ()),
    ("oarc", ("oarc.yaml", "d3fxe.yaml")),
    ("dcarc", ()),
    ("dcarc", ("d3fxe.yaml",)),
    ("dcarc", ("d3fxe_experiment.yaml",)),
    ("dcarc", ("d3fxe.yaml", "tuned/narrow_0.25_dcarc.yaml")),
]


@pytest.mark.parametrize("scenario", ["sine", "point_to_point"])
@pytest.mark.parametrize(("law", "names"), ORDINARY, ids=lambda v: "+".join(v) if isinstance(v, tuple) else v)
def test_nothing_is_said_in_the_first_examples_of_the_readme(config, scenario, law, names):
    made = settings(config, law, names, scenario=scenario)
    commands = build.commands({**made["command_source"], "duration": 2.0})
    loop = Loop(made["controller"], made["valve_simulator"])
    assert loop.run(len(commands), lambda t: float(commands[round(t / PERIOD)])).said == []


def burden(config, changes, scenario, duration=3.0):
    """Largest burden of dcarc over its bound on a valve of D3FXE's friction with other numbers."""
    made = settings(config, "dcarc", ("d3fxe.yaml",), scenario=scenario, duration=duration)
    plant = updated(VALVE, made["valve_simulator"], changes)
    run = offline.simulate(made["controller"], plant, build.commands(made["command_source"]))
    return float(np.max(run.terms["burden"] / run.terms["burden_bound"]))


def slower(share):
    """Model (3) with its poles and zeros ``share`` times as fast."""
    denominator = [c * share**i for i, c in enumerate(FOURTH_ORDER.denominator)]
    numerator = [c * share**i for i, c in enumerate(FOURTH_ORDER.numerator)]
    scale = FOURTH_ORDER.static_gain * denominator[-1] / numerator[-1]
    return {"valve": "custom", "numerator": [scale * c for c in numerator], "denominator": denominator}


@pytest.mark.parametrize("scenario", ["sine", "point_to_point"])
@pytest.mark.parametrize(
    "changes",
    [{"gain_scale": 0.3}, {"disturbance.offset": 5.0}, {"friction.coulomb": 6.0}, {"flow_force": 3.0}],
    ids=lambda changes: next(iter(changes)),
)
def test_a_valve_beyond_the_spread_of_the_weights_is_reported(config, changes, scenario):
    assert burden(config, changes, scenario) > 1.0


def test_the_box_that_the_weights_were_made_for_is_not_reported(config):
    random = np.random.default_rng(5)
    for _ in range(24):
        changes = {
            "gain_scale": random.uniform(0.7, 1.4),
            "friction.coulomb": random.uniform(0.0, 1.6),
            "friction.static_ratio": random.uniform(1.0, 1.6),
            "friction.presliding": random.uniform(0.01, 0.04),
            "flow_force": random.uniform(-0.5, 0.5),
            "disturbance.offset": random.uniform(-0.5, 0.5),
            "lvdt.delay": random.uniform(0.0, 1e-3),
            **slower(random.uniform(0.8, 1.25)),
        }
        scenario = str(random.choice(["sine", "point_to_point"]))
        assert burden(config, changes, scenario) < 1.0, changes
