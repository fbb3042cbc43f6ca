# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A plant that is no valve, with more states and sensors, in the same loop, which is not changed for it."""

import math
from typing import NamedTuple

import numpy as np
import pytest
import scipy.linalg

from valve_control.control import closed_loop


class Cart(NamedTuple):
    """Two carts joined by a spring, pushed at the first: an exact step with the force held."""

    m11: float
    m12: float
    m13: float
    m14: float
    m15: float
    m21: float
    m22: float
    m23: float
    m24: float
    m25: float
    m31: float
    m32: float
    m33: float
    m34: float
    m35: float
    m41: float
    m42: float
    m43: float
    m44: float
    m45: float
    stiffness: float  # N/m


class Motion(NamedTuple):
    """Positions [m] and velocities [m/s] of both."""

    x1: float
    v1: float
    x2: float
    v2: float


class Sensors(NamedTuple):
    """Three sensors."""

    position: float  # m  of the second cart
    velocity: float  # m/s  of the second cart
    spring: float  # N


class Gains(NamedTuple):
    """Of a law that uses all three."""

    kp: float
    kd: float
    ks: float


class Terms(NamedTuple):
    """What the law computed."""

    error: float
    force: float


class Seen(NamedTuple):
    """What is measured."""

    overshoot: float  # m
    samples: float


def read(p, s, noise):
    return Sensors(s.x2, s.v2, p.stiffness * (s.x1 - s.x2))


def step(p, s, force):
    return Motion(
        p.m11 * s.x1 + p.m12 * s.v1 + p.m13 * s.x2 + p.m14 * s.v2 + p.m15 * force,
        p.m21 * s.x1 + p.m22 * s.v1 + p.m23 * s.x2 + p.m24 * s.v2 + p.m25 * force,
        p.m31 * s.x1 + p.m32 * s.v1 + p.m33 * s.x2 + p.m34 * s.v2 + p.m35 * force,
        p.m41 * s.x1 + p.m42 * s.v1 + p.m43 * s.x2 + p.m44 * s.v2 + p.m45 * force,
    )


def law(p, s, command, reading, offset):
    error = reading.position - command
    force = -p.kp * error - p.kd * reading.velocity - p.ks * reading.spring
    return force, s, Terms(error, force)


def smoothed(p, s, given):
    """A command source with a state of its own: a first-order lag."""
    s = s + p * (given - s)
    return s, s


def watch(p, s, now, plant):
    beyond = max(s.overshoot, plant.x2 - 1.0)
    return Seen(beyond, s.samples + 1.0), plant.x2 > p


def shown(plant, now):
    return plant.x1, plant.x2, now.reading.spring, now.voltage


def cart(period, k, c):
    """Carts of 1 kg with a spring of ``k`` [N/m] and a damper of ``c`` [N·s/m] between them."""
    a = np.array([[0, 1, 0, 0, 0], [-k, -c, k, c, 1], [0, 0, 0, 1, 0], [k, c, -k, -c, 0], [0] * 5])
    return Cart(*(float(v) for v in scipy.linalg.expm(a * period)[:4].ravel()), k)


FUNCTIONS = {
    "next_command": smoothed, "read": read, "law_step": law, "measured": watch, "plant_step": step,
    "shown": shown,
}  # fmt: skip


def run(samples, limit, compiled=True, period=0.001):
    parts = closed_loop.Parts(0.01, Gains(3.0, 4.0, 0.1), cart(period, 400.0, 8.0), limit)
    begin = closed_loop.Parts(0.0, 0.0, Motion(0.0, 0.0, 0.0, 0.0), Seen(0.0, 0.0))
    signals, terms = np.zeros((samples, 4)), np.zeros((samples, 2))
    loop = closed_loop.build(FUNCTIONS, compiled)
    return loop(parts, begin, np.ones(samples), np.zeros(samples), signals, terms), signals, terms


def test_two_carts_settle_at_the_command_and_the_spring_goes_slack():
    end, signals, terms = run(20_000, math.inf)
    assert end.plant.x2 == pytest.approx(1.0, abs=1e-6) and end.plant.x1 == pytest.approx(1.0, abs=1e-6)
    assert signals[-1, 2] == pytest.approx(0.0, abs=1e-3) and end.measure.samples == 20_000
    assert 0.0 < end.measure.overshoot == signals[:, 1].max() - 1.0
    assert np.array_equal(terms[:, 1], signals[:, 3])


def test_the_continuous_solution_is_met():
    """The loop at 10 µs against the poles of the continuous one."""
    _, signals, _ = run(100_000, math.inf, period=1e-5)
    k, c, kp, kd, ks = 400.0, 8.0, 3.0, 4.0, 0.1
    lag = -math.log(1.0 - 0.01) / 1e-5
    a = np.array(
        [
            [0, 1, 0, 0, 0],
            [-k - ks * k, -c, k - kp + ks * k, c - kd, kp],
            [0, 0, 0, 1, 0],
            [k, c, -k, -c, 0],
            [0, 0, 0, 0, -lag],
        ]
    )
    b = np.array([0, 0, 0, 0, lag])
    rest = scipy.linalg.solve(a, -b)
    exact = rest + scipy.linalg.expm(a * (len(signals) - 1) * 1e-5) @ (np.zeros(5) - rest)
    assert signals[-1, 1] == pytest.approx(exact[2], abs=2e-4)


def test_plain_python_gives_the_same_bits_and_what_is_measured_can_end_a_run():
    compiled, plain = run(3000, 0.5), run(3000, 0.5, compiled=False)
    assert compiled[0] == plain[0] and np.array_equal(compiled[1], plain[1])
    assert compiled[0].plant.x2 > 0.5 and compiled[0].measure.samples < 3000
    assert np.all(compiled[1][int(compiled[0].measure.samples) :] == 0.0)
