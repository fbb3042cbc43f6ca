# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Plants as plug-ins: another package's plant in all loops, and those that are refused."""

import types
from typing import NamedTuple

import changed
import numpy as np
import pytest

from valve_control.control import closed_loop, plugins
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES, VALVE
from valve_control.control.plant import registry, solenoid_valve, valve
from valve_control.control.plant.plant import Plant, try_out
from valve_control.control.simulation import batch, offline, robustness
from valve_control.parameter import defaults, updated

COMMAND = 0.5 * np.sin(2.0 * np.pi * 2.0 * np.arange(1200) * 0.001)
REAL = {
    "valve": "solenoid", "solenoid.hysteresis": 0.2, "friction.coulomb": 0.3, "friction.presliding": 0.02,
    "solenoid.dead_time": 0.0007, "lvdt.delay": 0.0004, "lvdt.noise": 0.003, "solenoid.bits": 12,
    "solenoid.hum": 0.003, "solenoid.overlap": 0.1, "solenoid.u_min": -8.0,
}  # fmt: skip


def values(**more):
    return updated(VALVE, defaults(VALVE), {**REAL, **more})


def test_offline_runs_plain_python_and_batches_give_the_same_bits():
    law = changed.controller(controller="pid")
    runs = [offline.simulate(law, values(seed=7), COMMAND, compiled) for compiled in (True, False)]
    assert np.array_equal(runs[0].voltage, runs[1].voltage)
    assert np.array_equal(runs[0].measurement, runs[1].measurement)
    traces = np.empty((3, len(COMMAND), 3))
    rows = batch.records([build.valve_params(values())] * 3)
    found = batch.simulate(batch.Batch("pid", build.law_params(law), rows, [6, 7, 8], COMMAND), 2, traces)
    assert np.array_equal(traces[1, :, 1], runs[0].measurement)
    assert np.array_equal(traces[1, :, 2], runs[0].voltage)
    assert found.e_rms[1] == pytest.approx(runs[0].indices.e_rms, rel=1e-12)
    assert found.true_e_M[1] == runs[0].true_error["e_M"] and found.c_u[1] > 0.0


def test_a_study_varies_gain_and_speed_of_the_solenoid_valve():
    box = (robustness.Quantity("gain", 0.8, 1.2, "-"), robustness.Quantity("speed", 0.5, 2.0, "-"),
           robustness.Quantity("solenoid.hysteresis", 0.0, 0.6, "V"))  # fmt: skip
    settings = {
        "controller": changed.controller(controller="pid"),
        "valve_simulator": values(),
        "command_source": updated(
            NODES["command_source"], defaults(NODES["command_source"]), {"duration": 0.3, "scenario": "sine"}
        ),
    }
    study = robustness.Study(settings, 8, 3, box, (0.001,))
    found = robustness.run_chunk(study, 0, 8)
    drawn = robustness.settings_of_number(study, 5)["valve_simulator"]
    assert drawn["solenoid.gain"] == pytest.approx(0.9 * found.points[5, 0])
    assert drawn["solenoid.natural_frequency"] == pytest.approx(15.0 * found.points[5, 1])
    assert drawn["solenoid.hysteresis"] == found.points[5, 2]
    assert np.all(np.isfinite(found.results.e_rms)) and len(set(found.results.e_rms)) == 8


# Another package's plant: a lag whose velocity is that of its last sample


class Params(NamedTuple):
    u_max: float
    period: float
    share: float


class State(NamedTuple):
    x: valve.Row


def initial(params):
    return State(valve.Row(0.0, 0.0, 0.0, 0.0))


def read(params, state, noise):
    return state.x.x0


def step(params, state, voltage):
    moved = params.share * (voltage - state.x.x0)
    return State(valve.Row(state.x.x0 + moved, moved / params.period, 0.0, 0.0))


def lag_build(given):
    return Params(given["u_max"], given["sample_period"], given["lag.share"])


def lag_plant(**changes):
    module = types.ModuleType("test_plants")
    for part in (Params, State, initial, read, step):
        setattr(module, part.__name__, part)
    share = solenoid_valve.PARAMETERS[0]._replace(name="lag.share", default=0.1)
    made = solenoid_valve.PLANT._replace(
        name="lag", module=module, parameters=(share,), build=lag_build,
        model=lambda given: registry.PLANTS["linear"].model({**given, "valve": "second_order"}),
        linear=lambda params: registry.PLANTS["linear"].build(registry.TRIED | {"valve": "second_order"}),
    )  # fmt: skip
    return made._replace(**changes)


def test_a_plant_of_another_package_runs_in_the_loop(monkeypatch):
    plant = plugins.check(lag_plant(), Plant)
    try_out(plant, registry.TRIED)
    monkeypatch.setitem(registry._OF_PARAMS, Params, plant)
    signals = np.zeros((50, 3))
    from valve_control.control.laws import open_loop
    from valve_control.control.laws.signals import Start

    law = open_loop.LAW.build(updated(NODES["controller"], defaults(NODES["controller"]),
                                      {"open_loop.static_gain": 1.0}))  # fmt: skip
    begun = open_loop.LAW.module.initial(law, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    closed_loop.run_valve(
        open_loop.LAW.module, closed_loop.parts(law, Params(10.0, 0.001, 0.1)),
        closed_loop.parts(begun, initial(None)), np.ones(50), np.zeros(50), signals,
        np.zeros((0, len(open_loop.LAW.module.Terms._fields))), compiled=False,
    )  # fmt: skip
    assert signals[:, 0] == pytest.approx(1.0 - 0.9 ** np.arange(50))
