# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Watches of the table: noise that has grown, a spool that sticks, and a gain that drifts."""

import math
import re

import pytest
from grids import grid
from test_cycle_watch import LAWS, PERIOD, VALVES, Loop, sine

from research.campaigns import dirty
from valve_control.control.supervision import gain_watch, plausibility


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


@pytest.mark.parametrize(
    ("friction", "fault", "law", "level", "sticks"),
    [
        (1.0, "", "d3fxe_pid", 1.0, False),
        (1.0, "", "open_loop", 2.0, False),
        (4.0, "", "d3fxe_pid", 1.0, True),
        (4.0, "", "pid", 1.0, True),
        (1.0, "stuck", "open_loop", 2.0, True),
        (1.0, "stuck", "compensator", 2.0, True),
    ],
)
def test_a_spool_that_rests_away_from_command_or_voltage_is_told(friction, fault, law, level, sticks):
    """Hunting against the friction of cold oil, and a law without feedback that never gives much voltage."""
    case = dirty.Case(law, fault, "1", "start", 12, friction, level)
    given, conditions = dirty.signals(case), set()
    given = dirty.Signals(*(array[:3000] for array in given[:3]), 0)
    for *_, supervisor in dirty.samples(case, given):
        conditions |= set(supervisor.conditions)
    assert ("spool_sticks" in conditions) == sticks and supervisor.memory.counts["safe_stops"] == 0


MODEL = (20.0, 1200.0, 1200.0)  # a1 [1/s], a0, b0 [1/s²]


@grid("law, shipped", LAWS, VALVES, strength=1)
def test_an_lvdt_whose_gain_drifts_by_3_percent_a_second_is_reported(config, law, shipped):
    """Before its gain has doubled; the figure is that of the change, within a sixth."""
    loop = Loop.shipped(config, law, shipped)
    while "lvdt_gain" not in loop.supervisor.conditions and len(loop.readings) < 33000:
        loop.run(100, sine(1.5, 0.7), drift=0.03)
    loop.run(1000, sine(1.5, 0.7), drift=0.03)
    said = [text for text in loop.said if "start" in text and "over the voltage" in text]
    assert said and "lvdt_gain" in loop.supervisor.conditions
    assert float(re.search(r"are ([\d.]+) times", said[0]).group(1)) == pytest.approx(1.6, rel=0.17)


def entries(p, c, ratio, frequency, friction, seconds, s=gain_watch.NOTHING):
    """States of a valve with the model's poles whose readings are ``ratio`` times the model's."""
    a1, a0, b0 = MODEL
    omega = 2.0 * math.pi * frequency
    for k in range(int(seconds / c.span)):
        t = k * c.span
        y = 2.5 * math.sin(omega * t)
        v, a = 2.5 * omega * math.cos(omega * t), -omega * omega * y
        u = (a + a1 * v + a0 * y) / b0 + math.copysign(friction, v) + 0.2
        motion = ratio * y, ratio * v, u, True
        s = gain_watch.step(p, s, plausibility.Block(*motion, False, 0.0, u, 0.0, 0.0))
    return s


@pytest.mark.parametrize("ratio", [0.5, 0.9, 1.0, 1.2, 1.45, 2.0])
def test_the_change_is_measured_with_friction_and_offset(ratio):
    c = plausibility.design(MODEL, PERIOD, 1.0, 0.1)
    p = gain_watch.design({}, c)
    s = entries(p, c, 1.0, 1.0, 0.5, 6.0)
    s = entries(p, c, ratio, 1.0, 0.5, 20.0, s)
    assert s.usual / s.present == pytest.approx(ratio, rel=0.05)
    assert (gain_watch.text(p, s) != "") == (max(ratio, 1.0 / ratio) > gain_watch.CHANGED)


def test_fast_motion_tells_nothing():
    c = plausibility.design(MODEL, PERIOD, 1.0, 0.1)
    p = gain_watch.design({}, c)
    s = entries(p, c, 1.0, 5.0, 0.5, 6.0)
    assert s.usual == 0.0
