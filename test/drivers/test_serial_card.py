# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Driver of a serial card: the card's twin in Python and its firmware in C on the other side of the line."""

import ctypes
import math
import shutil
import subprocess

import pytest
from examples import EXAMPLES, serial_card
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.drivers import serial_card as driver_module
from valve_control.control.drivers.driver import DriverError
from valve_control.control.drivers.serial_frames import (
    COUNTS,
    FROM_CARD,
    ON,
    SENSOR,
    SILENCE,
    TO_CARD,
    Frame,
    Receiver,
    packed,
)
from valve_control.parameter import defaults

STEP = 10.0 / COUNTS  # V


@pytest.fixture
def card():
    made = serial_card.Card()
    yield made
    made.close()


def opened(card, **changes):
    values = {**defaults(driver_module.PARAMETERS), "serial.port": card.port, **changes}
    made = driver_module.make(values, 0.001, 0.0)
    made.open()
    return made


def names(driver):
    return [condition.name for condition in driver.conditions()]


# Frames


frames = st.builds(
    Frame, st.integers(0, 7), st.integers(0, 65535), st.integers(-COUNTS, COUNTS)
)  # flags, counter, value


@given(st.lists(st.tuples(frames, st.binary(max_size=4)), min_size=1), st.data())
def test_frames_are_found_however_the_stream_is_cut_and_whatever_lies_between(sent, data):
    stream = b"".join(packed(FROM_CARD, *frame) + noise.replace(b"\xa5", b"") for frame, noise in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=5)))
    receiver = Receiver(FROM_CARD)
    found = []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += receiver.feed(stream[begin:end])
    assert found == [frame for frame, _ in sent] and receiver.damaged == 0


# The driver with the twin


def test_readings_and_voltages_pass_and_off_is_off(card):
    driver = opened(card)
    card.receive(0.0)
    assert card.frames == 0  # opening writes nothing
    driver.enable(True)
    card.receive(0.0)
    assert card.voltage == 0.0
    driver.write(3.3)
    card.receive(0.001)
    assert card.voltage == pytest.approx(3.3, abs=STEP)
    for k in range(50):
        card.move()
        reading = card.send(0.001 * k)
        assert driver.read() == (pytest.approx(reading, abs=STEP), 0)
    assert reading > 0.1 and names(driver) == []
    driver.close()
    card.receive(0.06)
    assert card.voltage == 0.0 and card.frames == 4


def test_lost_and_damaged_frames_are_counted_and_a_wrap_is_no_loss(card):
    driver = opened(card)
    card.counter = 65533
    lost = []
    for k in range(8):
        if k == 4:
            card.counter += 2  # two frames get lost on the line
        card.send(0.0, damage=4 if k == 6 else 0)
        if k != 6:
            lost.append(driver.read().lost)
    assert lost == [0, 0, 0, 0, 2, 0, 1] and names(driver) == ["damaged_frames"]
    card.counter = 0  # a card that began anew
    card.send(0.0)
    assert driver.read().lost == 0
    card.counter = 40000
    card.send(0.0)
    assert driver.read().lost == 0
    driver.close()


def test_no_frame_is_no_reading_and_a_card_without_voltages_says_so(card):
    driver = opened(card)
    assert driver.read() is None
    driver.enable(True)
    card.receive(1.0)
    driver.write(5.0)
    card.receive(1.05)
    assert card.voltage == pytest.approx(5.0, abs=STEP)
    card.receive(1.05 + serial_card.WATCHDOG)
    assert card.voltage == 0.0
    card.send(1.05 + serial_card.WATCHDOG)
    driver.read()
    driver._switched = -math.inf  # the card has had its time to switch on
    assert names(driver) == ["card_silence"]
    card.sensor_sound = False
    driver.write(0.0)
    card.receive(1.2)
    card.send(1.2)
    assert math.isnan(driver.read().signal) and names(driver) == ["sensor_fault"]
    driver.close()


def test_a_card_that_keeps_its_output_off_although_it_hears_voltages_is_told(card):
    driver = opened(card)
    driver.enable(True)
    driver.write(5.0)
    card.receive(1.0)
    card._asked = False  # its own switch
    card.send(1.0)
    driver.read()
    assert names(driver) == []  # it may take GRACE to switch on
    driver._switched = -math.inf
    assert names(driver) == ["output_off"]
    driver.close()


def test_frames_from_before_are_no_readings_after_enable(card):
    """While the output is off nobody reads: what waits is old."""
    driver = opened(card)
    for _ in range(30):
        card.send(0.0)
    driver.enable(True)
    assert driver.due() == math.inf and driver.poll() is None
    card.send(0.0)
    assert driver.poll() == (pytest.approx(0.0, abs=0.1), 0) and driver.fileno() >= 0
    driver.close()


def test_of_frames_that_wait_too_long_the_newest_counts_and_the_others_are_lost(card):
    driver = opened(card)
    for count in (1, 101):
        for _ in range(count):
            card.send(0.0)
        assert driver.read().lost == count - 1 and driver.poll() is None
    driver.close()


def test_a_line_that_takes_no_more_voltages_is_told(card):
    driver = opened(card)
    driver.enable(True)
    for _ in range(2):  # the last frame is cut; then none passes
        with pytest.raises(DriverError, match=f"the line {card.port} does not take the voltages"):
            for _ in range(100_000):
                driver.write(1.0)
    driver.close()


def test_a_port_that_goes_away_is_told_in_a_sentence():
    card = serial_card.Card()
    driver = opened(card)
    driver.enable(True)
    port = card.port
    card.close()
    with pytest.raises(DriverError, match=f"the port {port} is gone"):
        for _ in range(3):
            driver.write(1.0)
            driver.read()
    driver.close()
    with pytest.raises(DriverError, match=f"the port {port} cannot be opened"):
        driver.open()
    driver.close()


# The firmware


BOARD = """
#include <stdint.h>
#include <string.h>
int16_t counts; int sound_now = 1, output_on = -1; int16_t given = 99; uint32_t now;
uint8_t sent[64]; int size;
int16_t read_lvdt(int *sound) { *sound = sound_now; return counts; }
void write_voltage(int16_t value) { given = value; }
void switch_output(int on) { output_on = on; }
void send_bytes(const uint8_t *data, int n) { memcpy(sent + size, data, (size_t)n); size += n; }
uint32_t milliseconds(void) { return now; }
"""


@pytest.fixture
def firmware(tmp_path):
    compiler = shutil.which("gcc") or shutil.which("cc")
    assert compiler, "no C compiler"
    (tmp_path / "board.c").write_text(BOARD)
    library = tmp_path / "card.so"
    subprocess.run(
        [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-shared", "-fPIC",
         "-o", library, EXAMPLES / "serial_card.c", tmp_path / "board.c"],
        check=True, timeout=60,
    )  # fmt: skip
    return ctypes.CDLL(str(library))


def variable(library, name, kind=ctypes.c_int):
    return kind.in_dll(library, name)


def test_the_firmware_speaks_the_frames_and_has_a_watchdog(firmware):
    now = variable(firmware, "now", ctypes.c_uint32)
    given = variable(firmware, "given", ctypes.c_int16)
    on = variable(firmware, "output_on")
    size = variable(firmware, "size")

    def sampled():
        size.value = 0
        firmware.sample_timer()
        (frame,) = Receiver(FROM_CARD).feed(
            bytes((ctypes.c_uint8 * 64).in_dll(firmware, "sent"))[: size.value]
        )
        return frame

    def heard(data):
        for byte in data:
            firmware.received(byte)

    variable(firmware, "counts", ctypes.c_int16).value = -12345
    assert sampled() == Frame(SILENCE, 0, -12345)
    now.value = 50
    heard(b"\x5a\x01\x02" + packed(TO_CARD, ON, 7, 3000))
    assert (given.value, on.value) == (3000, 1) and sampled() == Frame(ON, 1, -12345)
    damaged = bytearray(packed(TO_CARD, ON, 8, -3000))
    damaged[5] ^= 1
    heard(damaged)
    assert given.value == 3000
    heard(packed(TO_CARD, ON, 9, -32767))
    assert given.value == -32767
    variable(firmware, "sound_now").value = 0
    now.value = 149
    assert sampled().flags == ON | SENSOR and on.value == 1
    now.value = 150
    assert sampled().flags == SILENCE | SENSOR and (given.value, on.value) == (0, 0)
    heard(packed(TO_CARD, ON, 10, 100))
    assert (given.value, on.value) == (100, 1)
    heard(packed(TO_CARD, 0, 11, 100))
    assert (given.value, on.value) == (100, 0)
    heard(packed(TO_CARD, ON, 12, 3000))
    assert (given.value, on.value) == (3000, 1)
    now.value = 250
    assert sampled().flags == SILENCE | SENSOR and (given.value, on.value) == (100, 0)
