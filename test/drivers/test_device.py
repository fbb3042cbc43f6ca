# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A device in volts: scales, polarity and limits of both sides, losses, and a device that goes and comes."""

import math
import time

import pytest
from examples import serial_card

from valve_control.control.drivers import device as device_module
from valve_control.control.drivers.driver import DriverError, Reading
from valve_control.control.parameters import drivers
from valve_control.parameter import defaults, updated

STEP = 10.0 / 32767


@pytest.fixture
def card():
    made = serial_card.Card()
    yield made
    made.close()


def device(card, **changes):
    wanted = {name.replace("__", "."): value for name, value in changes.items()}
    table = drivers.VALVE_DRIVER
    return drivers.device(updated(table, defaults(table), {"serial.port": card.port, **wanted}))


def given(card):
    """Signal at the amplifier, in units of a full scale of 10."""
    card.receive(0.0)
    return card.voltage


def test_both_sides_have_scale_polarity_and_limits(card):
    one = device(
        card,
        position__scale="4..20mA", serial__full_scale_in=20.0, position__reversed=True,
        voltage__scale="0..10V", voltage__reversed=True, voltage__high=4.0,
    )  # fmt: skip
    one.open()
    one.enable(True)
    assert given(card) == pytest.approx(5.0, abs=STEP)  # 0 V is the middle of 0 to 10 V
    for voltage, signal in ((2.0, 4.0), (-10.0, 10.0), (9.0, 3.0)):  # the last one is limited to 4 V
        one.write(voltage)
        assert given(card) == pytest.approx(signal, abs=STEP)
    card._state = card._state._replace(x=card._state.x._replace(x0=8.0))  # 8 of 10: 16 of 20 mA
    card.send(0.0)
    assert one.read() == (pytest.approx(-5.0, abs=0.01), 0) and one.conditions() == ()
    card._state = card._state._replace(x=card._state.x._replace(x0=0.0))  # 0 mA: the wire is broken
    card.counter += 3
    card.send(0.0)
    reading = one.read()
    assert math.isnan(reading.signal) and reading.lost == 3 and one.lost == 3
    assert [c.name for c in one.conditions()] == ["wire_broken", "readings_lost"]
    one.write(2.0)
    assert given(card) == pytest.approx(5.0, abs=STEP), "0 V at once, not after the readings that are bridged"
    card._state = card._state._replace(x=card._state.x._replace(x0=8.0))
    card.send(0.0)
    one.read()
    one.write(2.0)
    assert given(card) == pytest.approx(4.0, abs=STEP)
    one.limit(one.position._replace(low=-5.0), one.voltage)
    card._state = card._state._replace(x=card._state.x._replace(x0=9.0))
    card.send(0.0)
    one.read()
    assert [c.name for c in one.conditions()] == ["out_of_range", "readings_lost"]
    one.close()
    assert given(card) == pytest.approx(5.0, abs=STEP) and not card._asked
    card.receive(serial_card.WATCHDOG)
    assert card.voltage == pytest.approx(5.0, abs=STEP), "the signal of 0 V by the card's watchdog too"


class Loose:
    """A driver whose plug is pulled and put back."""

    def __init__(self):
        self.plugged, self.calls, self.faults = True, [], ()

    def open(self):
        self.calls.append("open")
        self._need()

    def _need(self):
        if not self.plugged:
            raise DriverError("the plug is out")

    def enable(self, on):
        self._need()
        self.calls.append(f"enable {on}")

    def write(self, signal):
        self._need()
        self.calls.append(signal)

    def read(self):
        self._need()

    def close(self):
        self.calls.append("close")

    def conditions(self):
        return self.faults


def volts(driver):
    side = device_module.Side(device_module.Scale(1.0), -10.0, 10.0)
    made = device_module.Device(driver, side, side, 0.001)
    made.open()
    made.enable(True)
    return made


@pytest.mark.parametrize("voltage", [math.nan, math.inf, -math.inf])
def test_a_voltage_that_is_not_finite_gives_0_volts(voltage):
    loose = Loose()
    volts(loose).write(voltage)
    assert loose.calls[-1] == 0.0


class Polled(Loose):
    """One that can be polled: its readings, and the time of the next."""

    def __init__(self, readings, tick=0.0):
        super().__init__()
        self.readings, self.tick = readings, tick

    def poll(self):
        self._need()
        return self.readings.pop(0)

    def due(self):
        return self.tick

    def fileno(self):
        return 7


def test_a_polled_device_never_waits_and_tells_when_it_has_something():
    loose = Polled([None, Reading(2.0, 1), Reading(11.0, 0)], tick=time.monotonic() - 0.01)
    one = volts(loose)
    assert one.polled and one.fileno() == 7 and one.due() == loose.tick
    assert one.poll() is None and one.readings == one.late == 0
    assert one.poll() == (2.0, 1) and (one.readings, one.lost, one.late) == (1, 1, 1), "10 ms are ten periods"
    loose.tick = time.monotonic() + 1.0
    assert math.isnan(one.poll().signal) and one.late == 1
    assert [c.name for c in one.conditions()] == ["out_of_range", "readings_lost"]


@pytest.mark.parametrize("act", [lambda d: d.write(1.0), lambda d: d.read(), lambda d: d.enable(False)])
def test_a_device_that_goes_is_closed_told_and_opened_anew_as_it_was(act, monkeypatch):
    monkeypatch.setattr(device_module, "RETRY", 0.0)
    loose = Loose()
    one = volts(loose)
    loose.plugged = False
    act(one)
    one.enable(True)
    one.write(2.0)
    assert [(c.name, c.level, c.text) for c in one.conditions()] == [
        ("device_gone", "safe", "the plug is out")
    ]
    assert one.read() is None and one.conditions()[0].name == "device_gone"
    loose.plugged = True
    loose.calls.clear()
    one.read()
    assert loose.calls == ["open", "enable True"] and one.conditions() == () and one.reopened == 1
