# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The monitors of V2 and of dcarc's burden: silent in ordinary use, find a valve that leaves its ranges."""

import numpy as np
import pytest

from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER, NODES, VALVE
from valve_control.control.plant import valve
from valve_control.control.plant.models import FOURTH_ORDER
from valve_control.control.simulation import offline
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated

WEAK = 0.2  # of the gain, as in valve_simulator


def settings(config, law, names, **source):
    changes = files.given([str(config / name) for name in names], {}, [])
    made = {node: updated(table, defaults(table), changes[node]) for node, table in NODES.items()}
    made["controller"] = updated(CONTROLLER, made["controller"], {"controller": law})
    made["command_source"] = updated(NODES["command_source"], made["command_source"], source)
    return made


def supervised(made, duration):
    """All that a supervisor says in a run."""
    values = made["controller"]
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    p = build.valve_params(made["valve_simulator"])
    s = valve.initial(p)
    random = np.random.default_rng(int(made["valve_simulator"]["seed"]))
    commands = build.commands({**made["command_source"], "duration": duration})
    said = set()
    for k, command in enumerate(commands.tolist()):
        supervisor.command(command)
        s = valve.step(p, s, supervisor.sample(valve.read(p, s, random.standard_normal()), k + 1))
        said |= set(supervisor.conditions.values())
    return said


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
    assert supervised(made, 2.0) == set()


CONFIGS = [
    (),
    ("arc.yaml",),
    ("oarc.yaml",),
    ("arc.yaml", "oarc.yaml", "d3fxe.yaml"),
    ("d3fxe_experiment.yaml",),
]


@pytest.mark.campaign
@pytest.mark.parametrize("law", ["arc", "oarc", "dcarc"])
@pytest.mark.parametrize("names", CONFIGS, ids="+".join)
@pytest.mark.parametrize("scenario", ["sine", "point_to_point", "step", "sweep", "stepped_sine", "constant"])
def test_what_is_watched_stays_below_its_bound_for_300_s_in_ordinary_use(config, law, names, scenario):
    made = settings(config, law, names, scenario=scenario, duration=300.0)
    command = build.commands(made["command_source"])
    run = offline.simulate(made["controller"], made["valve_simulator"], command)
    name = "burden" if law == "dcarc" else "lyapunov"
    assert not np.any(run.terms[name] > run.terms[f"{name}_bound"])


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


def test_a_slow_valve_is_reported_where_the_motion_is_fast_enough_to_show_it(config):
    assert burden(config, slower(0.4), "sweep") > 1.0
    assert burden(config, slower(0.9), "sweep") < 0.7


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


@pytest.mark.parametrize("forgetting", [0.0, 5.0])
def test_the_burden_is_the_disturbance_however_much_of_it_is_learned(config, forgetting):
    """Offset d on a valve without friction: observer and weights together show d, its mean square d²."""
    made = settings(config, "dcarc", (), scenario="sine", amplitude=0.2, frequency=0.5, duration=6.0)
    values = updated(CONTROLLER, made["controller"], {"dcarc.forgetting": forgetting})
    plant = updated(VALVE, made["valve_simulator"], {"disturbance.offset": 0.8})
    run = offline.simulate(values, plant, build.commands(made["command_source"]))
    late = run.terms["burden"][3000:]
    assert np.max(np.abs(np.sqrt(late) - 0.8)) < 0.02 * 0.8
    assert np.min(run.terms["offset"]) < -0.3  # much of it is learned
