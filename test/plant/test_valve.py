# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The linear valve by closed forms; plants as plug-ins, another package's too, in all loops."""

import math
import types
from typing import NamedTuple

import changed
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control import closed_loop, plugins
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES, VALVE
from valve_control.control.plant import registry, solenoid_valve, valve
from valve_control.control.plant.plant import Plant, try_out
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, MODELS
from valve_control.control.simulation import batch, offline, robustness
from valve_control.parameter import defaults, updated


def made(**changes):
    return build.valve_params(changed.valve(**changes))


def run(p, voltages):
    s = valve.initial(p)
    out = []
    for voltage in voltages:
        out.append((s.x.x0, s.x.x1))
        s = valve.step(p, s, float(voltage))
    return np.array(out)


@pytest.mark.parametrize("name", MODELS)
def test_linear_part_equals_scipy_for_held_voltages(name):
    p = made(valve=name)
    u = np.random.default_rng(1).uniform(-10.0, 10.0, 400)
    model = MODELS[name]
    discrete = scipy.signal.cont2discrete(
        scipy.signal.tf2ss(model.numerator, model.denominator), p.period, method="zoh"
    )
    _, expected, _ = scipy.signal.dlsim(discrete, u)
    assert np.allclose(run(p, u)[:, 0], expected[:, 0], rtol=1e-7, atol=1e-8)


def test_static_gain_offset_and_flow_force():
    p = made(gain_scale=1.2, disturbance__offset=0.3, flow_force=0.4)
    final = run(p, [2.0] * 3000)[-1, 0]
    gain = 1.2 * FOURTH_ORDER.static_gain
    assert math.isclose(final, gain * 2.3 / (1.0 + gain * 0.4), rel_tol=1e-6)


@pytest.mark.parametrize("period", [1e-4, 1e-3, 5e-3])
def test_friction_only_ever_takes_energy(period):
    """Free motion with friction comes to rest at any period and never swings further than without."""
    valve_2 = {"valve": "second_order", "sample_period": period}
    u = np.where(np.arange(round(2.0 / period)) * period < 0.5, 5.0, 0.0)
    rubbed = run(made(**valve_2, friction__coulomb=1.0, friction__velocity_scale=0.01), u)
    free = run(made(**valve_2), u)
    assert np.max(rubbed[:, 0]) <= np.max(free[:, 0]) + 1e-9
    assert np.max(np.abs(rubbed[-10:, 1])) <= 0.01 * 1.001


def test_saturation_drift_and_lvdt():
    p = made(u_max=5.0)
    assert np.array_equal(run(p, [50.0] * 100), run(p, [5.0] * 100))
    drifting = run(made(drift__gain=0.1), [2.0] * 3000)[-1, 0]
    assert math.isclose(drifting, 2.0 * FOURTH_ORDER.static_gain * 1.3, rel_tol=0.01)
    for p in (made(drift__gain=-0.01), made(drift__gain=-0.01, valve="solenoid")):
        module = registry.plant_of(p).module
        s = module.initial(p)._replace(time=150.0)  # nothing is left of its gain
        assert module.step(p, s, 2.0).x[:2] == (0.0, 0.0)
    p = made(lvdt__resolution=0.01, lvdt__bias=0.123)
    assert math.isclose(valve.read(p, valve.initial(p), 0.0), 0.12)
    p = made(lvdt__noise=0.5)
    assert valve.read(p, valve.initial(p), 2.0) == 1.0


@pytest.mark.parametrize("delay", [0.001, 0.0025])
def test_lvdt_delay_is_that_of_a_shifted_response(delay):
    """Against the same valve at an eighth of the period; a straight line between samples is off by 1e-4 V."""
    p, fine = made(lvdt__delay=delay), made(sample_period=0.000125)
    s, exact = valve.initial(p), valve.initial(fine)
    readings, positions = [], []
    for k in range(1600):
        if k % 8 == 0:
            readings.append(valve.read(p, s, 0.0))
            s = valve.step(p, s, 3.0)
        positions.append(exact.x.x0)
        exact = valve.step(fine, exact, 3.0)
    late = round(delay / fine.period)
    shifted = np.concatenate([np.zeros(late), positions])[:1600:8]
    assert np.allclose(readings, shifted, atol=1e-6)


@given(
    bristle=st.floats(-1.0, 1.0),
    velocity=st.floats(-20.0, 20.0),
    free=st.floats(-50.0, 50.0),
    presliding=st.floats(1e-4, 1.0),
    period=st.sampled_from([1e-5, 1e-3, 1e-2]),
)
def test_bristles_solve_their_implicit_equation(bristle, velocity, free, presliding, period):
    d = made(friction__coulomb=1.2, friction__static_ratio=1.3, friction__presliding=presliding).disturbance
    mobility = 1.1
    level = valve.friction_level(d, velocity)
    rubbing, following = valve.friction(d, level, bristle, free, mobility, period)
    v = free - mobility * rubbing
    assert math.isclose(
        following, bristle + period / presliding * (v - abs(v) * following), rel_tol=1e-9, abs_tol=1e-9
    )
    assert abs(following) <= 1.0 and abs(rubbing) <= 1.2 * 1.3 * (1.0 + 1e-12)


def test_presliding_is_dahls_hysteresis():
    """Quasi-static, d = presliding: from rest z = 1 - exp(-x/d); back by s: z = -1 + (1 + z0)·exp(-s/d)."""
    p = made(friction__coulomb=1.0, friction__presliding=0.2)
    bristle, x, v = 0.0, 0.0, 0.5
    found = []
    for k in range(4000):
        v = 0.5 if k < 2000 else -0.5
        # a spool that a strong hand moves: friction cannot change its velocity
        _, bristle = valve.friction(p.disturbance, 1.0, bristle, v, 1e-12, p.period)
        x += v * p.period
        found.append((x, bristle))
    there, back = found[799], found[2399]
    assert math.isclose(there[1], -math.expm1(-there[0] / 0.2), rel_tol=2e-3)
    top, way = found[1999][1], found[1999][0] - back[0]
    assert math.isclose(back[1], -1.0 + (1.0 + top) * math.exp(-way / 0.2), abs_tol=2e-3)


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
