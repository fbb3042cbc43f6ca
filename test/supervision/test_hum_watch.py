# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A hum of the mains in the reading that moves the voltage less than ``oscillation_limit``."""

import math
import re

import numpy as np
import pytest
from test_cycle_watch import PERIOD, TUNED, Loop, sine

from valve_control.control.supervision import hum_watch, plausibility

THETA = (40.0, 1200.0, 1200.0)  # 1/s, 1/s², 1/s²
CHECK = plausibility.design(THETA, PERIOD, 0.04, 0.1)


def rest(t):
    return 0.0


def said(loop):
    return [text for text in loop.said if "hum of" in text]


@pytest.mark.parametrize(("law", "shipped"), TUNED)
def test_hum_of_20_mv_is_named_at_rest_and_in_slow_motion(config, law, shipped):
    """With the noise of the valve's LVDT. The frequency is that of the mains whatever the gains."""
    for frequency, command in ((50.0, rest), (60.0, sine(0.5, 0.5))):
        loop = Loop.shipped(config, law, shipped).run(300, command).run(2000, command, hum=(0.02, frequency))
        (text,) = said(loop)
        assert f"(mains: {frequency:.0f} Hz)" in text and loop.supervisor.memory.counts["safe_stops"] == 0
        told, at = (float(x) for x in re.search(r"hum of (\S+) mV at (\S+) Hz", text).groups())
        assert at == pytest.approx(frequency, abs=0.3)
        # The loop adds to the hum what the valve makes of the voltage.
        wave = np.hanning(1000) * np.exp(-2j * math.pi * frequency * PERIOD * np.arange(1000))
        seen = 4e3 * abs(np.mean(wave * np.array(loop.readings[-1000:])))
        assert told == pytest.approx(seen, rel=0.1)
        loop.run(1300, command)
        assert "lvdt_mains" not in loop.supervisor.conditions


def watched(readings, commands=None, grain=0.0, at=0.0):
    """State after ``readings`` [V] and ``commands`` [V], one a sample; the spool was ``at`` [V] before."""
    p, s, state = hum_watch.design({}, CHECK), hum_watch.NOTHING, plausibility.initial(CHECK, at, 0.0)
    for k, reading in enumerate(readings):
        state = plausibility.step(CHECK, state, float(reading), 0.0, 1.0)
        if state.held == 0.0:
            command = 0.0 if commands is None else float(commands[k])
            s = hum_watch.step(p, s, plausibility.SeenBlock(0.0, grain, 0.0, False, state.shown, command))
    return s


@pytest.mark.parametrize(
    ("amplitude", "frequency", "grain", "there"),
    [
        (0.02, 50.0, 0.0, 50.0),
        (0.02, 50.4, 0.0, 50.4),
        (0.02, 60.0, 0.0, 60.0),
        (0.02, 51.0, 0.0, 0.0),  # no mains
        (0.02, 47.0, 0.0, 0.0),
        (0.009, 50.0, 0.0, 0.0),  # below 10 mV
        (0.02, 50.0, 0.0195, 50.0),
        (0.018, 50.0, 0.0195, 0.0),  # below the converter's step
    ],
)
def test_amplitude_and_frequency_of_a_pure_hum(amplitude, frequency, grain, there):
    t = np.arange(1700) * PERIOD
    s = watched(amplitude * np.sin(2.0 * math.pi * frequency * t + 0.7) + 2.0, grain=grain)
    assert s.frequency == pytest.approx(there, abs=0.02)
    assert s.amplitude == pytest.approx(amplitude if there else 0.0, rel=0.03)


def test_a_line_that_the_command_has_is_no_hum():
    wave = 0.02 * np.sin(2.0 * math.pi * 50.0 * np.arange(1700) * PERIOD)
    assert watched(wave, wave).frequency == 0.0 and watched(wave, 0.1 * wave).frequency > 0.0


def test_noise_alone_is_no_hum():
    """White noise of 30 mV, 20 times 10 s: three windows in a row never agree."""
    random = np.random.default_rng(4)
    for _ in range(20):
        assert watched(0.03 * random.standard_normal(10_000)).frequency == 0.0
