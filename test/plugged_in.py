# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What a law of another package has to do here; run by test_plugins.py with both examples installed."""

import math
import shutil
import subprocess

import changed
import numpy as np
import pytest
from made import Run, write
from scipy.signal import StateSpace

from valve_control.control.laws.registry import LAWS, LEFT_OUT
from valve_control.control.linear import margins
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.simulation import batch, offline
from valve_control.design.tuning import search, trial
from valve_control.export import folder, unit
from valve_control.parameter import defaults, updated
from valve_control.recordings import shadow_replay
from valve_control.recordings.recording import load

COMMAND = 0.5 * np.sin(2.0 * math.pi * 2.0 * np.arange(2000) * 0.001)
VALUES = {"lvdt.noise": 0.003, "friction.coulomb": 0.2}


@pytest.fixture(params=["lead", "observer"])
def name(request):
    return request.param


def settings(controller, **changes):
    return changed.controller(controller=controller, **changes)


def test_it_is_one_of_the_laws(name):
    assert LEFT_OUT == {} and name in list(LAWS)[-2:] and LAWS[name].package == f"valve_{name}_law"
    assert LAWS[name].feedback and not LAWS[name].adapts


def test_offline_runs_batches_and_plain_python_give_the_same_bits(name):
    plant = updated(VALVE, defaults(VALVE), VALUES)
    runs = [offline.simulate(settings(name), plant, COMMAND, compiled) for compiled in (True, False)]
    assert np.array_equal(runs[0].voltage, runs[1].voltage) and runs[0].warning == ""
    found = batch.simulate(
        batch.Batch(name, build.law_params(settings(name)), build.valve_params(plant), [1] * 9, COMMAND)
    )
    assert found.true_e_M[3] == runs[0].true_error["e_M"]
    open_loop = offline.simulate(settings("open_loop"), plant, COMMAND, compiled=False)
    assert runs[0].indices.e_rms < 0.5 * open_loop.indices.e_rms


def test_its_margins_are_told_and_its_gains_are_found(name):
    plants = [
        build.valve_params(updated(VALVE, defaults(VALVE), {**VALUES, "gain_scale": g})) for g in (0.8, 1.2)
    ]
    motion = trial.TuningMotion("sine", COMMAND)
    limits = trial.TuningLimits(3.0, 20.0, 0.0005, 10.0, 0.05, 0.02, 0.0)
    problem = trial.Problem(settings(name), [motion], plants, plants, limits, False, 1)
    told = margins.margins(LAWS[name], build.law_params(settings(name)), margins.prepared(plants))
    assert np.all(np.isfinite(told.gain_db)) and told.gain_db[0] > told.gain_db[1] > 3.0
    found = search.search(LAWS[name], problem, search.phases(0.3), 60, 1, lambda done: None)
    before = trial.run(LAWS[name], problem, [trial.GainSet({}, 0.0)])[0].error
    assert min(p.error for p in found.points if p.chatter < 0.3) < 0.7 * before


def test_the_poles_of_observer_and_loop_are_where_the_example_places_them():
    law, p = LAWS["observer"].module, build.law_params(settings("observer"))
    continuous = StateSpace([[0, 1], [-p.a0, -p.a1]], [[0], [p.b0]], np.eye(2), np.zeros((2, 1)))
    valve = continuous.to_discrete(p.period)

    def next_numbers(numbers):
        """Of valve and observer after a sample in the loop."""
        state = law.State(law.reshaping.State(0.0, 0.0), law.Row(*numbers[2:]))
        voltage, state, _ = law.step(p, state, 0.0, numbers[0], 0.0)
        return [*(valve.A @ numbers[:2] + valve.B[:, 0] * voltage), *state.valve]

    poles = np.linalg.eigvals(np.transpose([next_numbers(unit) for unit in 1e-3 * np.eye(5)]) * 1e3)
    w, v = 60.0, 200.0  # rad/s, as the defaults
    wanted = [*np.roots([1, np.sqrt(2) * w, w**2]), *np.roots([1, 2 * v, 2 * v**2, v**3])]
    assert np.allclose(np.sort_complex(np.log(poles) / p.period), np.sort_complex(wanted), rtol=1e-6)


def test_high_gains_are_warned_of():
    run = offline.simulate(settings("lead", lead__gain=900.0), defaults(VALVE), COMMAND[:200])
    assert "lead with these gains is unstable" in run.warning


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_it_is_exported_to_c_with_the_same_bits(tmp_path, name):
    folder.write(tmp_path / name, folder.files(unit.law(settings(name, lead__gain=3.0))))
    done = subprocess.run(["make", "-C", tmp_path / name, "check"], capture_output=True, text=True)
    assert done.returncode == 0 and f"{name}: 3002 rows equal to the last bit" in done.stdout, done.stderr


@pytest.mark.parametrize("other", ["arc", "oarc", "dcarc", "pid", "compensator"])
def test_takeovers_to_and_fro_are_bumpless_and_replayed_bit_for_bit(tmp_path, name, other):
    run = Run(controller={"controller": name})
    run.move(400)
    for law in (other, name):
        run.change(controller=law)
        run.move(400)
    run.change(lead__gain=3.0, observer__loop=90.0)
    run.move(200)
    steps = np.abs(np.diff(run.voltages))
    assert steps[399] < 1e-9 and steps[799] < 1e-9  # the first voltage of a law is the last of the other
    recording = load(write(tmp_path / "bag", run.messages), journals=True)
    result = shadow_replay.replay(recording.valves["valve"], {})
    assert result.faithful and result.differing == 0 and result.left_out == []
    assert np.array_equal(result.voltage, run.voltages)
