# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Even cycles of the voltage: which are found, their source, and that those at its limit are stopped."""

import cmath
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from changed import THIRD_ORDER
from hypothesis import example, given, settings
from hypothesis import strategies as st

from valve_control.control.analysis.limit_cycle import limit_cycle
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision import cycle_watch, lock_in, oscillation
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated

PERIOD = 1e-3  # s
LAWS, VALVES = ("arc", "oarc", "dcarc", "pid"), ("d3fxe", "d3fxe_experiment")
TUNED = [(law, shipped) for law in LAWS for shipped in VALVES]


class Loop:
    """A supervisor and a valve, whose readings can come late, with a hum, with another gain, or stand."""

    def __init__(self, controller, plant):
        self.values = updated(CONTROLLER, defaults(CONTROLLER), controller)
        self.supervisor = Supervisor()
        self.supervisor.apply(self.values, build.law_params(self.values))
        self.p = build.valve_params(updated(VALVE, defaults(VALVE), plant))
        self.s = valve.initial(self.p)
        self.random = np.random.default_rng(1)
        self.readings, self.voltages, self.said, self.names = [], [], [], set()

    @classmethod
    def shipped(cls, config, law, shipped, **plant):
        """Tuned gains on their valve, with changes of ``plant``."""
        gains = files.load(str(config / "tuned" / f"{shipped}_{law}.yaml"))["controller"]
        own = files.load(str(config / f"{shipped}.yaml"))["valve_simulator"]
        return cls({"controller": law, **gains}, {**own, **plant})

    def run(self, samples, command, late=0, hum=(0.0, 0.0), drift=0.0, frozen=None):
        """``late`` [samples]; ``hum``: amplitude [V], frequency [Hz]; ``drift`` [1/s] of the LVDT's gain.

        ``frozen`` [V]: the reading.
        """
        for _ in range(samples):
            t = len(self.readings) * PERIOD
            self.supervisor.command(command(t))
            reading = (1.0 + drift * t) * valve.read(self.p, self.s, self.random.standard_normal())
            reading += hum[0] * math.sin(2.0 * math.pi * hum[1] * t)
            self.readings.append(reading if frozen is None else frozen)
            reading = self.readings[max(0, len(self.readings) - 1 - late)]
            self.voltages.append(self.supervisor.sample(reading, len(self.readings)))
            self.said += [text for text in self.supervisor.conditions.values() if text not in self.said]
            self.names |= set(self.supervisor.conditions)
            self.s = valve.step(self.p, self.s, self.voltages[-1])
        return self


def sine(amplitude, frequency):
    return lambda t: amplitude * math.sin(2.0 * math.pi * frequency * t)


@pytest.mark.parametrize(("law", "shipped"), TUNED)
def test_readings_that_are_late_end_in_0_v_and_the_dead_time_is_said(config, law, shipped):
    """A limit cycle at the limit of the voltage is off within 2 s, and then less and less often on."""
    loop = Loop.shipped(config, law, shipped).run(700, sine(1.0, 1.5))
    assert loop.said == [] or law == "arc"
    loop.run(6000, sine(1.0, 1.5), late=10)
    stopped = [text for text in loop.said if "at the limit of the voltage" in text]
    assert stopped and "dead time" in stopped[0]
    late = float(re.search(r"about (\S+) ms later", stopped[0])[1])
    assert 4.0 < late < 16.0
    on = np.abs(loop.voltages[700:]) > 0.0
    assert np.mean(on[:2000]) > 0.1
    assert np.mean(on[-2000:]) < 0.7


@pytest.mark.parametrize("frequency", [50.0, 60.0])
@pytest.mark.parametrize(("law", "shipped"), TUNED)
def test_hum_of_the_mains_is_named(config, law, shipped, frequency):
    """40 mV: the sentence has its frequency, its amplitude and the reading as the source."""
    loop = Loop.shipped(config, law, shipped, **{"lvdt.noise": 0.002})
    loop.run(300, sine(0.5, 0.5)).run(1300, sine(0.5, 0.5), hum=(0.04, frequency))
    said = [text for text in loop.said if "oscillates" in text]
    assert said and "limit cycle" not in said[0]
    assert f"(mains: {frequency:.0f} Hz) come in through the LVDT reading" in said[0]
    amplitude = float(re.search(r": (\S+) mV", said[0])[1])
    assert 24.0 < amplitude < 56.0
    assert loop.supervisor.memory.counts["safe_stops"] == 0


@given(
    st.floats(20.0, 120.0),
    st.floats(-0.03, 0.03),
    st.floats(0.5, 3.0),
    st.floats(0.0, 0.7),
    st.floats(-2.0, 2.0),
)
@example(99.5, 0.0, 0.5, 0.0, 2.0)  # the mean leaked into a reading of millivolts
@settings(deadline=None, max_examples=60)
def test_lock_in_measures_gain_lag_and_frequency(frequency, off, gain, turn, mean):
    """Against the frequency response of the model; ``off``: error of the assumed frequency."""
    p = SimpleNamespace(a1=40.0, a0=1200.0, b0=1200.0, period=PERIOD)
    omega = 2.0 * math.pi * frequency
    answer = (
        p.b0
        / (p.a0 - omega**2 + 1j * omega * p.a1)
        * gain
        * cmath.exp(-0.5j * omega * PERIOD - 2j * math.pi * turn)
    )
    s, k = lock_in.begun(frequency * (1.0 + off), PERIOD), 0
    while not lock_in.finished(s):
        wave = cmath.exp(1j * (omega * k * PERIOD + 0.7))
        s = lock_in.step(s, mean + wave.real, mean + (answer * wave).real, PERIOD)
        k += 1
    found = lock_in.found(p, s)
    assert found.frequency == pytest.approx(frequency, rel=3e-3)
    assert found.gain == pytest.approx(gain, rel=0.005)
    assert (found.lag * frequency - turn + 0.5) % 1.0 - 0.5 == pytest.approx(0.0, abs=0.02)


def test_cycles_that_a_quick_command_brings_about_are_not_stopped(config):
    """A square wave and a fast sine that saturate the voltage at each turn."""
    for command in (lambda t: math.copysign(3.0, math.sin(40.0 * t)), sine(2.9, 15.0)):
        loop = Loop.shipped(config, "oarc", "d3fxe").run(2500, command)
        assert np.mean(np.abs(loop.voltages) > 9.0) > 0.1
        assert loop.supervisor.memory.counts["safe_stops"] == 0 and not [
            t for t in loop.said if "oscillates" in t
        ]


def test_a_reading_that_swings_while_the_voltage_stands_is_a_hum_of_that_amplitude():
    p = SimpleNamespace(a1=40.0, a0=1200.0, b0=1200.0, period=PERIOD)
    s, k = lock_in.begun(50.0, PERIOD), 0
    while not lock_in.finished(s):
        s = lock_in.step(s, 1.0, 0.03 * math.sin(2.0 * math.pi * 50.0 * k * PERIOD), PERIOD)
        k += 1
    found = lock_in.found(p, s)
    assert found.hum == pytest.approx(0.03, rel=1e-3) and found.gain == 0.0
    assert lock_in.step(s, 5.0, 5.0, PERIOD) == s, "a finished measurement stays"


@pytest.mark.parametrize(
    ("gain", "frequency", "hum", "height", "source"),
    [(5.0, 70.0, 0.02, 2.0, cycle_watch.HUM),  # a valve is not five times as strong as its model
     (5.0, 70.0, 0.02, 20.0, cycle_watch.LIMIT_CYCLE),  # but may be where the voltage saturates
     (11.0, 70.0, 0.02, 20.0, cycle_watch.LIMIT_CYCLE),
     (11.0, 100.0, 0.02, 20.0, cycle_watch.HUM),
     (3.0, 100.0, 0.02, 2.0, cycle_watch.HUM),
     (3.0, 70.0, 0.02, 2.0, cycle_watch.LIMIT_CYCLE),
     (5.0, 100.0, 0.004, 2.0, cycle_watch.LIMIT_CYCLE)],  # rounding by 10 mV alone adds as much
)  # fmt: skip
def test_the_source_of_cycles_is_the_reading_where_no_such_valve_can_be(gain, frequency, hum, height, source):
    cycles = oscillation.NOTHING._replace(height=height)
    found = lock_in.LockInResult(frequency, gain, 0.0, hum)
    assert cycle_watch.source(cycles, found, 9.0, 0.01) == source


@pytest.mark.parametrize(
    ("small", "full", "turns", "unexplained"),
    [(4.0, 0.0, 0.0, True),
     (0.0, 4.0, 0.0, True),
     (3.0, 3.0, 0.0, False),  # too few
     (4.0, 4.0, 8.0, False)],  # the command turns as often
)  # fmt: skip
def test_cycles_of_either_height_count_if_the_command_has_them_not(small, full, turns, unexplained):
    cycle, swing = (oscillation.NOTHING._replace(cycles=n, turns=turns) for n in (small, full))
    assert cycle_watch.unexplained(cycle, swing) == unexplained


@pytest.mark.parametrize(
    ("file", "low", "high"),
    [("arc.yaml", 60.0, 70.0), ("oarc.yaml", 44.0, 51.0), ("pid_plain.yaml", 54.0, 61.0)],
)
def test_limit_cycle_of_the_shipped_laws_on_a_third_order_valve_is_reported(config, file, low, high):
    loop = Loop(files.load(str(config / file))["controller"], THIRD_ORDER)
    loop.run(1500, lambda t: 0.3 if t >= 0.25 else 0.0)
    sentence = next(text for text in loop.said if "voltage oscillates at" in text)
    words = sentence.split()
    assert low < float(words[3]) < high and float(words[6]) == pytest.approx(10.0, abs=0.5)
    assert sentence.endswith("limit cycle of law and valve")
    assert any("at the limit of the voltage" in text for text in loop.said)
    assert loop.supervisor.memory.counts["safe_stops"] == 1


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
