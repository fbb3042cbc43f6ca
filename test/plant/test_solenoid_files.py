# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The valves of config/solenoid: each runs, and has the figure of its source."""

import math
from pathlib import Path

import numpy as np
import pytest

from valve_control.control.compiling import compile_function
from valve_control.control.parameters import files
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import solenoid, solenoid_valve
from valve_control.parameter import defaults, updated

FOLDER = Path(__file__).resolve().parents[2] / "config" / "solenoid"
STEP = compile_function(solenoid.step)
TIMES = {"d634": 0.020, "d633": 0.012, "d661": 0.0065}  # s  0 to 90 % of a step of 10 V
FREQUENCIES = {"d3fxe": 6.48, "d136": 60.0, "voice_coil": 250.0}  # Hz  of -90°


def valve(name, **changes):
    given = files.load(str(FOLDER / f"{name}.yaml"))["valve_simulator"]
    return solenoid_valve.build(updated(VALVE, defaults(VALVE), {**given, **changes}))


def positions(p, voltages):
    state, made = solenoid.initial(p), []
    for voltage in voltages:
        made.append(state.x.x0)
        state = STEP(p, state, float(voltage))
    return np.array(made)


def test_there_are_six_and_each_has_a_figure():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*TIMES, *FREQUENCIES}


@pytest.mark.parametrize("name", TIMES)
def test_a_step_takes_the_time_of_the_source(name):
    p = valve(name, sample_period=0.0001)
    x = positions(p, np.full(1500, 10.0))
    assert np.argmax(x >= 0.9 * x[-1]) * 0.0001 == pytest.approx(TIMES[name], rel=0.03)


@pytest.mark.parametrize("name", FREQUENCIES)
def test_the_phase_is_a_quarter_turn_at_the_frequency_of_the_source(name):
    """Small motions; the model of the paper, source of d3fxe, has neither friction nor flow force."""
    without = {"friction.coulomb": 0.0, "flow_force": 0.0, "solenoid.hysteresis": 0.0}
    p = valve(name, sample_period=0.0001, **(without if name == "d3fxe" else {}))
    frequency = FREQUENCIES[name]
    t = np.arange(round(20.0 / frequency / 0.0001)) * 0.0001
    turn = np.exp(-2j * np.pi * frequency * t)
    x = positions(p, np.sin(2.0 * np.pi * frequency * t))
    steady = t > 10.0 / frequency
    phase = np.angle(2j * np.mean(x[steady] * turn[steady]))
    assert math.degrees(phase) == pytest.approx(-90.0, abs=4.0)
