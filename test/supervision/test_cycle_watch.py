# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Even cycles of the voltage: their source is measured, and those at its limit are stopped."""

import cmath
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

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
