# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""LVDTs with a quiet converter: equal readings in a row are no fault, and a frozen LVDT is still found."""

import math

import numpy as np
import pytest
from grids import grid
from test_cycle_watch import Loop

from valve_control.control.laws import registry
from valve_control.control.parameters import files
from valve_control.control.supervision import lvdt
from valve_control.control.supervision.memory import Mode

PERIOD = 1e-3  # s
BITS = {bits: 20.0 / 2**bits for bits in (10, 12)}  # V  steps of converters over ±10 V
FRICTION = {
    "valve": "fourth_order", "gain_scale": 1.213, "flow_force": 0.116, "friction.coulomb": 1.16,
    "friction.static_ratio": 1.25, "friction.stribeck_velocity": 0.017, "friction.presliding": 0.02,
}  # fmt: skip
COMMANDS = {
    "steps": lambda t: math.copysign(1.0, 0.5 - t % 1.0),
    "staircase": lambda t: 0.5 * math.floor(3.0 * t) % 4.0,
    "slow sine": lambda t: math.sin(2.0 * math.pi * 0.2 * t),
    "sine": lambda t: 2.0 * math.sin(2.0 * math.pi * 1.5 * t),
    "held": lambda t: 2.0 if t > 0.3 else 0.0,
}
SHIPPED = ["arc", "oarc", "dcarc", "pid"]


@grid("bits, law, plant, command", BITS, registry.LAWS, [{}, FRICTION], COMMANDS)
def test_no_false_alarm_of_the_lvdt_with_the_usual_gains(config, law, bits, plant, command):
    own = files.load(str(config / "d3fxe.yaml"))["controller"] if plant else {}
    loop = Loop({"controller": law, **own}, {**plant, "lvdt.resolution": BITS[bits]})
    loop.run(2200, COMMANDS[command])
    assert loop.supervisor.memory.counts["safe_stops"] == 0
    assert not [name for name in loop.names if name.startswith("lvdt")]


@grid("bits, law, phase", BITS, SHIPPED, range(0, 660, 110))
def test_an_lvdt_that_freezes_in_motion_is_found(law, bits, phase):
    """Within 60 ms at more than 15 V/s; near the turn of the sine once the command has left it."""
    loop = Loop({"controller": law}, {"lvdt.resolution": BITS[bits]}).run(667 + phase, COMMANDS["sine"])
    speed = abs(loop.s.x.x1)
    frozen = loop.run(1, COMMANDS["sine"]).readings[-1]
    n = 0
    while loop.supervisor.mode is not Mode.SAFE and n < 400:
        loop.run(1, COMMANDS["sine"], frozen=frozen)
        n += 1
    assert "lvdt_frozen" in loop.supervisor.conditions
    assert n <= (60 if speed > 15.0 else 250)


@pytest.mark.parametrize("law", SHIPPED)
@pytest.mark.parametrize(
    ("own", "command", "longest"),
    [
        ({}, lambda t: 4.0, 150),
        ({"u_max": 4.0}, lambda t: 1.0, 60),
        ({"lvdt.disturbance": 0.0}, lambda t: 1.0, 200),
        ({}, lambda t: math.sin(2.0 * math.pi * 30.0 * t), 60),
    ],
    ids=["step", "weak amplifier", "not compared", "30 Hz"],
)
def test_an_lvdt_that_freezes_at_rest_is_found_when_the_command_moves(law, own, command, longest):
    """The law pulls by more than any disturbance, or 0.7 of the amplifier's voltage; the reading stands."""
    loop = Loop({"controller": law, **own}, {"lvdt.resolution": BITS[12]}).run(200, lambda t: 0.0)
    n = 0
    while loop.supervisor.mode is not Mode.SAFE and n < longest:
        loop.run(1, command, frozen=0.0)
        n += 1
    assert "lvdt_frozen" in loop.supervisor.conditions


@pytest.mark.parametrize(
    ("noise", "noisy"), [(0.0, False), (0.1, False), (0.3, False), (0.6, False), (1.5, True), (5.0, True)]
)
def test_scatter_tells_noise_from_rounding(noise, noisy):
    """White noise gives 4σ², rounding at most one squared step, at rest and in motion; ``noise`` in steps."""
    p = lvdt.Params(11.0, 500.0, 0.1, 20, 0.5, PERIOD, 58.0, 1657.0, 1502.0, 5.0)
    random = np.random.default_rng(3)
    for speed in (0.0, 0.37, 2.5):  # steps a sample
        s, shares = lvdt.NOTHING, []
        for k in range(3000):
            reading = 0.005 * math.floor(speed * k % 1000 + 0.5 + noise * random.standard_normal())
            _, s = lvdt.step(p, s, reading, 0, 0.0, False, 0.0)
            shares.append(s.standing.scatter / 0.005**2)
        assert (np.median(shares[1000:]) > lvdt.NOISY) == noisy, (speed, np.median(shares[1000:]))


@pytest.mark.parametrize(("speed", "fault"), [(8.0, lvdt.SOUND), (41.0, "lvdt_frozen")])
def test_a_spool_may_stop_within_the_distance_that_friction_needs(speed, fault):
    """v²/(2·b0·D) is 4 mV at 8 V/s, within three steps of 5 mV, and 112 mV at 41 V/s."""
    p = lvdt.Params(11.0, 500.0, 0.1, 20, 0.5, PERIOD, 58.0, 1657.0, 1502.0, 5.0)
    s, found = lvdt.NOTHING, []
    for k in range(140):
        moved = 0.5 * speed * min(k, 100) ** 2 * PERIOD / 100.0
        reading = 0.005 * math.floor(moved / 0.005 + 0.5)
        judged, s = lvdt.step(p, s, reading, 0, reading * p.a0 / p.b0, False, 0.0)
        found.append(judged)
    assert found[-1] == fault and set(found[:101]) == {lvdt.SOUND}


def judged(b0, samples):
    """What is said of ``samples``: reading [V], voltage [V], whether something else keeps it off."""
    p, s = lvdt.Params(11.0, 500.0, 0.1, 20, 0.5, PERIOD, 20.0, 1200.0, b0, 1.0), lvdt.NOTHING
    said = []
    for reading, voltage, blocked in samples:
        fault, s = lvdt.step(p, s, reading, 0, voltage, blocked, PERIOD)
        said.append(fault)
    return said


@pytest.mark.parametrize(("off", "first"), [(0, 10), (15, 15), (40, 0)])
def test_a_noisy_lvdt_that_stands_is_frozen_once_the_voltage_moves_again(off, first):
    """20 equal readings, 9 of them before the voltage is off for ``off`` samples; then it moves.

    Where they become 20 without voltage, they are counted anew from there, without the voltage before.
    """
    noise = np.random.default_rng(3).normal(0.0, 0.05, 200)
    before = [*((float(x), 0.0, False) for x in noise), *((0.0, 0.3 * k, False) for k in range(10))]
    said = judged(0.0, [*before, *[(0.0, 0.0, True)] * off, *[(0.0, 3.0, False)] * 40])
    assert said.index("lvdt_frozen") == len(before) + off + first
