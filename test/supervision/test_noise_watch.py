# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The noise of the LVDT is measured at rest and in motion, and reported when it has grown."""

import math

import numpy as np
import pytest
from grids import grid
from hypothesis import given, settings
from hypothesis import strategies as st
from test_cycle_watch import LAWS, VALVES, Loop, sine

from valve_control.control.supervision import noise_watch, plausibility

PERIOD = 1e-3  # s


def louder(loop, factor):
    loop.p = loop.p._replace(lvdt=loop.p.lvdt._replace(noise=factor * loop.p.lvdt.noise))
    return loop


@grid("law, shipped, command", LAWS, VALVES, [sine(2.0, 1.5), lambda t: 0.0])
def test_noise_that_is_ten_times_larger_is_named_with_its_figure(config, law, shipped, command):
    loop = Loop.shipped(config, law, shipped).run(1300, command)
    assert not [text for text in loop.said if "noise" in text]
    louder(loop, 10.0).run(900, command)
    said = [text for text in loop.said if "noise" in text]
    assert len(said) == 1 and "lvdt_noise" in loop.supervisor.conditions
    assert float(said[0].split()[3]) == pytest.approx(1e3 * loop.p.lvdt.noise, rel=0.2)
    louder(loop, 0.1).run(1000, command)
    assert "lvdt_noise" not in loop.supervisor.conditions


@pytest.mark.parametrize("bits", [None, 10, 12])
@pytest.mark.parametrize("law", ["arc", "pid"])
def test_motion_and_rounding_are_no_noise(config, law, bits):
    """Rest, then steps and fast sines; a quiet converter has no noise at rest."""
    quiet = {} if bits is None else {"lvdt.noise": 0.0, "lvdt.resolution": 20.0 / 2**bits}
    loop = Loop.shipped(config, law, "d3fxe", **quiet).run(1200, lambda t: 0.0)
    for command in (lambda t: math.copysign(2.0, math.sin(20.0 * t)), sine(2.0, 8.0), sine(1.0, 20.0)):
        loop.run(600, command)
    assert not [text for text in loop.said if "noise" in text]


@given(st.floats(0.0005, 0.1), st.floats(0.0, 40.0), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_white_noise_on_a_motion_is_measured(deviation, speed, seed):
    check = plausibility.design((20.0, 1200.0, 1200.0), PERIOD, 1.0, 0.1)._replace(span=PERIOD)
    p, s = noise_watch.design({"sample_period": PERIOD}, check), noise_watch.NOTHING
    nothing = plausibility.initial(check, 0.0, 0.0).shown
    readings = speed * PERIOD * np.arange(253) + deviation * np.random.default_rng(seed).standard_normal(253)
    for second in np.diff(readings, 2).tolist():
        s = noise_watch.step(p, s, plausibility.SeenBlock(second, 0.0, 0.0, False, nothing, 0.0))
        if s.windows > 0.0:
            break
    assert s.usual == pytest.approx(deviation, rel=0.35)
