# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The inverse of the static curve: alone, around every law, offline, in batches and under the supervisor."""

import numpy as np
import pytest
from changed import controller, valve
from grids import grid
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.laws import linearisation
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.parameters import build
from valve_control.control.plant import valve as linear
from valve_control.control.simulation import batch, offline
from valve_control.control.supervision.supervisor import Supervisor

TIME = 0.001 * np.arange(1500)
SINE = 2.0 * np.sin(2.0 * np.pi * 3.0 * TIME)
LOPSIDED = {
    "linearisation__enabled": True,
    "linearisation__voltage": [-10.0, -0.32, 0.32, 10.0],
    "linearisation__position": [-8.9725, -0.0185, 0.0215, 10.4275],
    "linearisation__gain": 1.0,
}
SIDES = {
    "linearisation__enabled": True,
    "linearisation__voltage": [-10.0, 0.0, 10.0],
    "linearisation__position": [-8.5, 0.0, 9.5],
    "linearisation__gain": 0.9,
}


def rising(most=32):
    """Points of a curve: steps of the abscissa and slopes between them."""
    return st.lists(st.tuples(st.floats(0.05, 0.3), st.floats(0.02, 5.0)), min_size=1, max_size=most - 1).map(
        lambda steps: (np.cumsum([0.0, *(d for d, _ in steps)]) - 3.0, [s for _, s in steps])
    )


def table(made):
    at, slopes = made
    position = np.concatenate([[0.0], np.cumsum(np.diff(at) * slopes)]) - 3.0
    return {"linearisation__voltage": at.tolist(), "linearisation__position": position.tolist()}


@given(rising(), st.floats(-60.0, 60.0), st.floats(0.1, 3.0))
def test_the_inverse_undoes_the_curve_and_is_the_interpolation(made, voltage, gain):
    values = controller(**table(made), linearisation__gain=gain)
    forward, inverse = linearisation.forward(values), linearisation.inverse(values)
    seen = linearisation.value(forward, voltage)
    assert linearisation.value(inverse, seen) == pytest.approx(voltage, abs=1e-7)
    at, position = values["linearisation.voltage"], values["linearisation.position"]
    if at[0] <= voltage <= at[-1]:
        assert gain * seen == pytest.approx(np.interp(voltage, at, position), abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_a_law_on_unequal_sides_is_the_law_on_equal_ones(law):
    """The inverse takes the curve away: two loops of linear valves, one with the curve and its inverse."""
    values = controller(controller=law, **SIDES)
    params = LAWS[law].build(values)
    behind = linearisation.behind(values, params)
    plant = build.valve_params(valve(lvdt__noise=0.002))
    at, position = values["linearisation.voltage"], values["linearisation.position"]
    ends, commands = [], 9.0 * np.sin(2.0 * np.pi * 3.0 * TIME[:600])
    noise = np.random.default_rng(2).standard_normal(len(commands))
    for module, p, curve in (
        (LAWS[law].module, params, lambda u: u),
        (linearisation.around(LAWS[law].module), behind, lambda u: float(np.interp(u, at, position)) / 0.9),
    ):
        spool = linear.initial(plant)
        first = linear.read(plant, spool, 0.0)
        state = module.initial(p, Start(first, 0.0, first, 0.0, 0.0))
        rows, voltage = [], 0.0
        for k, command in enumerate(commands.tolist()):
            reading = linear.read(plant, spool, float(noise[k]))
            if k % 50 == 49:
                state = module.hold(p, state, command, reading, voltage)
            else:
                voltage, state, terms = module.step(p, state, command, reading, 0.0)
            rows.append([spool.x.x0, voltage, curve(voltage), *terms])
            spool = linear.step(plant, spool, curve(voltage))
        ends.append(np.array(rows))
    straight, curved = ends
    assert np.allclose(np.delete(curved, 1, axis=1), np.delete(straight, 1, axis=1), rtol=1e-6, atol=1e-6)
    share = np.where(straight[:, 1] > 0.0, 0.9 / 0.95, 0.9 / 0.85)
    assert np.allclose(curved[:, 1], share * straight[:, 1], atol=1e-6)
    assert np.max(np.abs(straight[:, 1])) == params.u_max or law in ("open_loop", "compensator")


def test_the_limit_is_what_the_amplifier_can_give_on_both_sides():
    values = controller(**LOPSIDED)
    limit = linearisation.seen(values)["u_max"]
    assert limit == pytest.approx(8.9725)
    for name in LAWS:
        assert LAWS[name].build(values).u_max == limit
    run = offline.simulate(
        controller(controller="pid", **LOPSIDED), valve(), 8.0 * np.sign(np.sin(20.0 * TIME)), compiled=False
    )
    assert np.min(run.voltage) == pytest.approx(-10.0) and np.max(run.voltage) < 8.7 and run.saturated > 0.1


@grid("law, plant", ["pid", "dcarc"], ["fourth_order", "solenoid"], strength=1)
def test_plain_python_compiled_loop_batch_and_supervisor_have_the_same_bits(law, plant):
    c, v = controller(controller=law, **LOPSIDED), valve(valve=plant, lvdt__noise=0.003, seed=5)
    run = offline.simulate(c, v, SINE)
    plain = offline.simulate(c, v, SINE, compiled=False)
    assert np.array_equal(run.voltage, plain.voltage) and np.array_equal(run.position, plain.position)
    made = linearisation.behind(c, build.law_params(c))
    for params in (made, batch.records([made])):
        traces = np.empty((1, len(SINE), 3))
        batch.simulate(batch.Batch(law, params, build.valve_params(v), [5], SINE), 1, traces)
        assert np.array_equal(traces[0, :, 2], run.voltage)
    supervisor = Supervisor()
    supervisor.apply(c, build.law_params(c))
    for k in range(len(SINE)):
        supervisor.command(float(SINE[k]))
        assert supervisor.sample(float(run.measurement[k]), k + 1) == run.voltage[k]
        assert supervisor.voltage == run.voltage[k]
