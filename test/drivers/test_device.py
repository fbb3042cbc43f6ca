# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A device in volts: scales, limits, losses, one that goes and comes; and the simulated valve as one."""

import math
import time

import changed
import numpy as np
import pytest
from examples import serial_card
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.drivers import device as device_module
from valve_control.control.drivers import simulated, ticks, trial
from valve_control.control.drivers.driver import Condition, DriverError, PolledDriver, Reading
from valve_control.control.drivers.scaling import Scale, ScaleError, parse
from valve_control.control.drivers.simulated import BACKLOG, SimulatedValve
from valve_control.control.parameters import build, drivers
from valve_control.control.plant import valve
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


def asked(card):
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
    assert asked(card) == pytest.approx(5.0, abs=STEP)  # 0 V is the middle of 0 to 10 V
    for voltage, signal in ((2.0, 4.0), (-10.0, 10.0), (9.0, 3.0)):  # the last one is limited to 4 V
        one.write(voltage)
        assert asked(card) == pytest.approx(signal, abs=STEP)
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
    assert asked(card) == pytest.approx(5.0, abs=STEP), "0 V at once, not after the readings that are bridged"
    card._state = card._state._replace(x=card._state.x._replace(x0=8.0))
    card.send(0.0)
    one.read()
    one.write(2.0)
    assert asked(card) == pytest.approx(4.0, abs=STEP)
    one.limit(one.position._replace(low=-5.0), one.voltage)
    card._state = card._state._replace(x=card._state.x._replace(x0=9.0))
    card.send(0.0)
    one.read()
    assert [c.name for c in one.conditions()] == ["out_of_range", "readings_lost"]
    one.close()
    assert asked(card) == pytest.approx(5.0, abs=STEP) and not card._asked
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


def test_a_device_that_goes_after_a_fault_is_tried_again_in_time_and_its_output_stays_off():
    loose = Polled([Reading(1.0, 0)])
    one = volts(loose)
    loose.plugged, loose.faults = False, (Condition("overheated", "safe", "it is too hot"),)
    assert one.poll() is None and [c.name for c in one.conditions()] == ["device_gone"] and one.fileno() == -1
    loose.plugged, loose.faults = True, ()
    assert one.poll() is None and one.read() is None and one.reopened == 0
    assert 0.0 < one.due() - time.monotonic() <= device_module.RETRY
    one._retry_at = 0.0  # the time is over
    assert one.poll() is None and one.reopened == 1 and loose.calls[-2:] == ["open", "enable False"]
    one.write(2.0)
    assert loose.calls[-1] == "enable False", "no voltage"
    (told,) = one.conditions()
    assert (told.name, told.level) == ("fault_before", "safe") and "after overheated: the output" in told.text
    one.enable(True)
    assert one.conditions() == () and one.poll() == (1.0, 0)


def test_a_dry_run_without_a_reading_tells_the_faults_and_no_figures():
    loose = Loose()
    loose.faults = (Condition("wire_broken", "safe", "no supply"),)
    one = volts(loose)
    lines = trial.told(trial.run(one, 0.001), one, 0.001)
    assert lines == ["readings   0, of which 0 not valid; 0 lost", "wire_broken: no supply"]
    assert loose.calls[-1] == "close"


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


numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
factors = st.floats(1e-3, 1e3).flatmap(lambda f: st.sampled_from([f, -f]))


@pytest.mark.parametrize(
    ("word", "low", "centre", "high"),
    [("V", -10.0, 0.0, 10.0), ("-10..10V", -10.0, 0.0, 10.0), ("%", -100.0, 0.0, 100.0),
     ("0..10V", 0.0, 5.0, 10.0), ("4..20mA", 4.0, 12.0, 20.0)],
)  # fmt: skip
def test_words_make_their_whole_range_ten_volts_to_each_side(word, low, centre, high):
    scale = parse(word)
    assert [scale.volts(signal) for signal in (low, centre, high)] == [-10.0, 0.0, 10.0]
    assert [scale.signal(volts) for volts in (-10.0, 0.0, 10.0)] == [low, centre, high]
    assert scale.live_zero == (3.6 if word == "4..20mA" else -math.inf)


@pytest.mark.parametrize(
    ("text", "scale"),
    [("*250", Scale(250.0)), ("*1.25-15", Scale(1.25, -15.0)), (" * -2e-1 + .5 ", Scale(-0.2, 0.5)),
     ("*1e-3-1e+2", Scale(0.001, -100.0))],
)  # fmt: skip
def test_formulas_are_read(text, scale):
    assert parse(text) == scale


@pytest.mark.parametrize(
    "text", ["", "mA", "*", "*0", "*0.0+1", "*1e999", "*1+-1", "*nan", "2", "*2 3", "*1-1-1"]
)
def test_what_is_no_scale_is_refused_with_the_words(text):
    with pytest.raises(ScaleError, match=r"4\.\.20mA.*\*factor±offset"):
        parse(text)


@given(factors, numbers, numbers)
def test_signal_and_volts_are_inverse_and_polarity_mirrors(factor, offset, volts):
    scale = Scale(factor, offset)
    assert scale.volts(scale.signal(volts)) == pytest.approx(volts, rel=1e-9, abs=1e-9 * (1.0 + abs(offset)))
    signal = scale.signal(volts)
    assert scale.reversed().volts(signal) == -scale.volts(signal)


@given(factors.map(lambda f: float(f"{f:g}")), numbers.map(lambda f: float(f"{f:g}")))
def test_a_scale_is_written_as_it_is_read(factor, offset):
    assert parse(str(Scale(factor, offset))) == Scale(factor, offset)
