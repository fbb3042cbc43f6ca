# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated valve as a device: the bits of the plant, its clock, and a dry run with it."""

import changed
import numpy as np
import pytest

from valve_control.control.drivers import simulated, ticks
from valve_control.control.drivers.driver import PolledDriver
from valve_control.control.drivers.simulated import BACKLOG, SimulatedValve
from valve_control.control.parameters import build
from valve_control.control.plant import valve

P = build.valve_params(changed.valve(lvdt__noise=0.004))


def made(paced):
    driver = SimulatedValve(P, 3, paced)
    driver.open()
    driver.enable(True)
    return driver


def test_readings_have_the_bits_of_the_plant_under_the_same_voltages():
    driver, spool, random = made(False), valve.initial(P), np.random.default_rng(3)
    assert isinstance(driver, PolledDriver) and driver.fileno() == -1 and driver.due() == 0.0
    for k in range(200):
        if k > 0:
            spool = valve.step(P, spool, max(-P.u_max, min(P.u_max, 0.1 * k)))
        assert driver.read() == (valve.read(P, spool, float(random.standard_normal())), 0)
        driver.write(0.1 * (k + 1))
    driver.open()
    assert driver.poll() == (
        valve.read(P, valve.initial(P), float(np.random.default_rng(3).standard_normal())),
        0,
    )
    assert driver.conditions() == ()


class Clock:
    """Time that goes on only where somebody waits."""

    def __init__(self):
        self.now = 100.0004

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def test_a_paced_one_gives_one_reading_a_tick_and_makes_up_for_late_ones(monkeypatch):
    clock = Clock()
    for module in (simulated, ticks):
        monkeypatch.setattr(module, "time", clock)
    driver = made(True)
    assert driver.poll() is None and driver.due() == pytest.approx(100.001)
    assert driver.read().lost == 0 and clock.now == pytest.approx(100.001)
    assert driver.poll() is None and driver.due() == pytest.approx(100.002)
    clock.now += 0.5 * BACKLOG
    assert [driver.poll().lost for _ in range(10)] == [0] * 10 and driver.poll() is None
    state = driver._state
    clock.now += 2.0 * BACKLOG
    assert driver.poll().lost == round(2.0 * BACKLOG / P.period) - 1 and driver.poll() is None
    for _ in range(round(2.0 * BACKLOG / P.period)):
        state = valve.step(P, state, 0.0)
    assert driver._state == state, "the spool moved meanwhile"
