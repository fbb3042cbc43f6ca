# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The watch over the voltage: finds limit cycles, of any height and in any motion; leaves the rest alone."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.analysis.limit_cycle import limit_cycle
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated

PERIOD = 0.001
W = 2.0 * math.pi * 12.0
THIRD_ORDER = {
    "valve": "custom",
    "numerator": [1.3 * W * W],
    "denominator": np.polymul([1.0, 2.0 * 0.9 * W, W * W], [1.0 / (2.0 * math.pi * 60.0), 1.0]).tolist(),
    "friction.coulomb": 0.6,
    "lvdt.noise": 0.008,
    "lvdt.delay": 0.0004,
}  # 12 Hz with a damping of 0.9, and a pole at 60 Hz


def supervised(values, plant, command, samples):
    """Times [s] and reasons of what a supervisor reports over ``samples``, and the supervisor."""
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    p = build.valve_params(updated(VALVE, defaults(VALVE), plant))
    s = valve.initial(p)
    noise = np.random.default_rng(1).standard_normal(samples)
    said = []
    for k in range(samples):
        supervisor.command(command(k * PERIOD))
        s = valve.step(p, s, supervisor.sample(valve.read(p, s, noise[k]), k + 1))
        if supervisor.memory.changed:
            supervisor.memory.changed = False
            said.append((k * PERIOD, supervisor.reason))
    return said, supervisor


def step_at_quarter(height):
    return lambda t: height if t >= 0.25 else 0.0


@pytest.mark.parametrize(
    ("file", "low", "high"),
    [("arc.yaml", 60.0, 70.0), ("oarc.yaml", 44.0, 51.0), ("pid_plain.yaml", 54.0, 61.0)],
)
def test_limit_cycle_of_the_shipped_laws_on_a_third_order_valve_is_reported(config, file, low, high):
    changes = files.given([str(config / file)], {}, [])["controller"]
    values = updated(CONTROLLER, defaults(CONTROLLER), changes)
    said, supervisor = supervised(values, THIRD_ORDER, step_at_quarter(0.3), 1500)
    reported = [(t, text) for t, text in said if "voltage oscillates at" in text]
    assert reported and reported[0][0] < 0.8
    sentence = next(part for part in reported[0][1].split("; ") if "oscillates" in part)
    words = sentence.split()
    assert low < float(words[3]) < high and float(words[6]) == pytest.approx(10.0, abs=0.5)
    assert sentence.endswith("limit cycle of law and valve")
    assert any("at the limit of the voltage" in text for _, text in said)
    assert supervisor.memory.counts["safe_stops"] == 1


def found(voltage, command=None, amplitude=1.0, period=PERIOD):
    command = np.zeros_like(voltage) if command is None else command
    return limit_cycle(voltage, command, period, amplitude)


T = np.arange(6000) * PERIOD


@given(
    st.floats(3.0, 120.0),
    st.floats(1.3, 10.0),
    st.floats(0.0, 0.45),
    st.integers(0, 1000),
    st.floats(-3.0, 3.0),
)
@settings(deadline=None, max_examples=60)
def test_finds_frequency_and_amplitude_beneath_noise_and_motion(frequency, amplitude, noise, seed, slope):
    random = np.random.default_rng(seed)
    wave = amplitude * np.sin(2.0 * math.pi * frequency * T)
    voltage = np.clip(wave + slope * T + noise * random.uniform(-1.0, 1.0, len(T)), -10.0, 10.0)
    cycle = found(voltage, slope * T)
    if np.max(np.abs(voltage)) < 10.0:
        assert cycle is not None
        assert cycle.frequency == pytest.approx(frequency, rel=0.05)
        assert cycle.amplitude == pytest.approx(amplitude, rel=0.35)


@given(st.floats(0.2, 5.0), st.floats(0.0, 0.99), st.integers(0, 10**6))
@settings(deadline=None, max_examples=60)
def test_noise_of_any_colour_is_no_limit_cycle(rms, pole, seed):
    """White noise, and noise behind a low-pass with its ``pole`` anywhere."""
    random = np.random.default_rng(seed).standard_normal(len(T))
    voltage = np.zeros(len(T))
    for k in range(1, len(T)):
        voltage[k] = pole * voltage[k - 1] + random[k]
    assert found(np.clip(rms * voltage / np.std(voltage), -10.0, 10.0)) is None


@pytest.mark.parametrize("frequency", [0.5, 3.0, 6.0, 20.0, 60.0])
@pytest.mark.parametrize("friction", [0.0, 1.5])
def test_what_the_command_has_is_no_limit_cycle(frequency, friction):
    """A sine, and the friction that turns with it."""
    command = 2.9 * np.sin(2.0 * math.pi * frequency * T)
    voltage = np.clip(
        4.0 * np.roll(command, -3) / 2.9 + friction * np.sign(np.cos(2 * np.pi * frequency * T)), -10, 10
    )
    assert found(voltage, command) is None


@pytest.mark.parametrize("frequency", [3.0, 9.13, 20.0])
def test_the_third_harmonic_of_friction_is_no_limit_cycle(frequency):
    """Under a sine; the same voltage is one under a command that rests, or at another frequency."""
    phase = 2.0 * math.pi * frequency * T
    command = 0.2 * np.sin(phase)
    voltage = np.sin(phase + 0.4) + 2.0 * np.sin(3.0 * phase)
    assert found(voltage, command) is None
    assert found(voltage, np.zeros(len(T))).frequency == pytest.approx(3.0 * frequency, rel=0.02)
    assert found(2.0 * np.sin(3.9 * phase), command).frequency == pytest.approx(3.9 * frequency, rel=0.02)


def test_a_staircase_of_a_slower_upper_level_is_no_limit_cycle():
    """Commands at 50 Hz: each step kicks the voltage."""
    command = np.repeat(8.0 * np.arange(300) * 0.02 / 6.0, 20)
    kick = np.tile(np.concatenate([np.full(3, 3.0), np.full(17, -0.3)]), 300)
    assert found(command + kick, command) is None
    assert found(command + kick, 8.0 * T / 6.0) is not None
