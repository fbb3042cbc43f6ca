# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""CANopen, CiA 408: the driver against a valve in another process, behind slcan on a pseudo-terminal."""

import errno
import math
import time
from contextlib import closing

import can
import pytest
from spool import device, until

from valve_control.control.drivers import canopen_states as states
from valve_control.control.drivers.can_bus import CanNode
from valve_control.control.drivers.canopen_408 import KIND, PARAMETERS
from valve_control.control.drivers.driver import DriverError
from valve_control.parameter import ParameterError, defaults, updated

PERIOD = 0.01  # s


def driver(valve, **changes):
    usual = {"interface": "slcan", "channel": valve.address, "node": 5, "adapter_pause": 0.0}
    patient = {"sdo_timeout": 1.0, "watchdog": 0.5, "heartbeat": 0.2}  # of a busy machine
    named = {f"canopen.{name}": value for name, value in {**usual, **patient, **changes}.items()}
    return KIND.make(updated(PARAMETERS, defaults(PARAMETERS), named), PERIOD, 0.0)


@pytest.fixture(scope="module")
def started():
    with device("valve_408", "5", "408", "", str(PERIOD)) as process:
        yield process


@pytest.fixture
def valve(started):
    for order in ("bus_off 0", "enable 1", "reset"):
        started.order(order)
    return started


@pytest.fixture
def running(valve):
    """Driver of a valve that is ACTIVE at 2 V."""
    made = driver(valve)
    made.open()
    activate(made, valve)
    yield made
    made.close()


def activate(made, valve):
    made.enable(True)

    def active():
        made.write(20.0)
        made.read()
        return valve.order("state") == "ACTIVE 2.0001 OPERATIONAL"  # 3277 counts

    until(active, "ACTIVE at 2 V")
    assert not {c.name for c in made.conditions() if c.level == "safe"}


def taken(made, number):
    """So many readings, those that come in time."""
    return [until(made.read, "a reading") for _ in range(number)]


def names(made):
    return {c.name: c.level for c in made.conditions()}


def fault(made, name):
    """Read until the driver tells fault ``name``, giving 2 V all the time."""

    def told():
        made.read()
        made.write(20.0)
        return names(made).get(name) == "safe"

    until(told, name)


def test_nothing_moves_before_enable_and_the_valve_is_off_at_the_end(valve):
    made = driver(valve)
    made.open()
    made.write(20.0)
    assert made.read() == (0.0, 0) and names(made) == {"polled": "degraded"}
    assert valve.order("state") == "INIT 0.0000 PRE-OPERATIONAL"
    activate(made, valve)
    readings = taken(made, 100)
    # Model (3): 0.83 V/V. 3277 of 16384 counts are 2 V.
    assert readings[-1].signal == pytest.approx(16.7, abs=0.5)
    made.enable(False)
    assert taken(made, 5) and valve.order("state") == "DISABLED 0.0000 OPERATIONAL", "readings go on"
    activate(made, valve)
    made.enable(False)
    until(lambda: valve.order("state") == "DISABLED 0.0000 OPERATIONAL", "off without a reading")
    activate(made, valve)
    made.close()
    assert valve.order("state") == "INIT 0.0000 PRE-OPERATIONAL"


def test_lost_actual_values_are_counted(running, valve):
    running.read()
    valve.order("emergency 0000")  # all is well again: no fault
    valve.order("drop 4")
    found = until(running.read, "a reading")
    assert found.lost >= 4 and names(running) == {"pdo_lost": "degraded"}
    assert valve.order("state").startswith("ACTIVE")


@pytest.mark.parametrize(
    ("order", "name", "then"),
    [("mute", "heartbeat_lost", "DISABLED 0.0000"), ("emergency 3100", "emergency", "DISABLED 0.0000"),
     ("enable 0", "wrong_state", "DISABLED 0.0000"), ("quiet_fault", "fault", "FAULT 0.0000"),
     ("reset", "node_reset", "INIT 0.0000"), ("bus_off 1", "bus_silent", "FAULT 0.0000"),
     ("local 1", "local_control", "DISABLED 0.0000"), ("stop", "not_operational", "FAULT 0.0000")],
)  # fmt: skip
def test_faults_are_named_switch_off_and_stay_off_until_enabled_anew(running, valve, order, name, then):
    running._since = -math.inf  # the valve has had its time to become ACTIVE
    valve.order(order)
    fault(running, name)
    until(lambda: (running.read(), valve.order("state").startswith(then))[1], then)
    for back in ("enable 1", "bus_off 0", "local 0"):
        valve.order(back)
    for _ in range(5):
        running.read()
        running.write(20.0)
    assert valve.order("state").startswith(then), "it does not start by itself"
    assert "enabled anew" in str(running.conditions())
    activate(running, valve)


def test_a_computer_that_is_bus_off_switches_off_until_enabled_anew(running, valve):
    running._node.bus_off = True
    fault(running, "bus_off")
    until(lambda: (running.read(), valve.order("state").startswith("DISABLED 0.0000"))[1], "off")
    activate(running, valve)
    assert not running._node.bus_off


def test_the_valve_goes_off_by_itself_when_this_process_stands_still(running, valve):
    until(lambda: valve.order("state").startswith("FAULT 0.0000"), "the valve's own watchdog")


def test_a_valve_that_cannot_watch_its_set_point_is_told_all_the_time():
    with device("valve_408", "5", "408", "0x1400:5,0x1016:1", str(PERIOD)) as valve:
        made = driver(valve)
        made.open()
        activate(made, valve)
        assert names(made)["no_watchdog"] == "degraded"
        made.close()


def test_a_valve_that_watches_no_set_point_watches_the_heartbeat_of_the_driver():
    with device("valve_408", "5", "408", "0x1400:5", str(PERIOD)) as valve:
        made = driver(valve)
        made.open()
        activate(made, valve)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            made.read()
            made.write(20.0)
        assert valve.order("state").startswith("ACTIVE") and "no_watchdog" not in names(made)
        until(lambda: valve.order("state").startswith("FAULT 0.0000"), "the valve's watch over the heartbeat")
        made.close()


def answering(node, answers):
    """A node whose SDO server sends ``answers``, in lists, to one request after the other."""
    waiting, pump = list(answers), node.pump

    def send(identifier, data=b"", remote=False):
        if data[0] != 0x80:
            node._sdo.responses.queue.extend(waiting.pop(0))

    node._network.send_message = send
    node._sdo.pump = lambda limit: time.sleep(min(limit, 0.005))
    return pump


def test_an_answer_after_its_time_out_is_not_taken_for_the_next():
    """Of another object, and of the same."""
    answer = {n: b"\x4b\x01\x63\x01" + bytes([n]) + b"\0\0\0" for n in (1, 2, 3, 4)}
    other = b"\x4b\x11\x63\x01\x09\0\0\0"
    node = CanNode(5, 0.05, interface="virtual", channel="late")
    answering(node, [[], [other, answer[1]], [], [answer[2], answer[3]], [answer[4]]])
    with pytest.raises(DriverError):
        node.get(0x6311, 1, "h")
    assert node.get(0x6301, 1, "h") == 1
    with pytest.raises(DriverError):
        node.get(0x6301, 1, "h")
    assert node.get(0x6301, 1, "h") == 3 and node.get(0x6301, 1, "h") == 4
    answering(node, [[], [answer[2]]])
    with pytest.raises(DriverError):
        node.get(0x6301, 1, "h")
    node._sdo.responses.put(answer[1])  # it comes before the next request, which waits for no other one
    node._sdo.RESPONSE_TIMEOUT, begun = 10.0, time.monotonic()
    assert node.get(0x6301, 1, "h") == 2 and time.monotonic() < begun + 5.0
    node.close()


def test_frames_that_are_no_sound_data_are_left_out_and_that_of_bus_off_is_noted():
    node, told = CanNode(5, 0.05, interface="virtual", channel="frames"), []
    node.on_heartbeat(told.append)
    node.on(0x185, lambda *words: told.append(words))
    with can.Bus(interface="virtual", channel="frames") as other:
        for identifier, data in ((0x705, b""), (0x185, None), (0x705, b"\5")):
            other.send(can.Message(0.0, identifier, False, data is None, data=data))
        other.send(can.Message(arbitration_id=0x40, is_error_frame=True))
        node.pump(0.0)
        assert told == [5] and node.bus_off
    node.close()


def test_a_full_buffer_is_a_lost_frame_and_only_a_lasting_one_a_lost_device():
    node, full = CanNode(5, 0.1, interface="virtual", channel="full"), True
    taken_frames = []

    def send(identifier, data=b"", remote=False):
        if full:
            raise can.CanOperationError("No buffer space available", errno.ENOBUFS)
        taken_frames.append(identifier)

    node._network.send_message = send
    node.patience = 0.02
    assert not node.send(0x80)
    full = False
    assert node.send(0x80) and taken_frames == [0x80]
    full = True
    assert not node.send(0x80)
    time.sleep(0.03)
    with pytest.raises(DriverError, match="No buffer space"):
        node.send(0x80)
    node.close()


@pytest.mark.parametrize(
    ("words", "changes", "said"),
    [(("5",), {"node": 6}, "node 6 does not answer on /dev/pts/.*canopen.node"),
     (("5", "402"), {}, "node 5 has the device profile 402; it must have 408"),
     (("5", "408", "0x6311:1"), {}, "refuses object 0x6311:01.*set canopen.reference"),
     (("5",), {"interface": "no_such"}, r"no CAN bus /dev/pts/\d+ \(no_such\)"),
     (("5",), {"interface": "kvaser"}, r"no CAN bus /dev/pts/\d+ \(kvaser\)"),
     (("5",), {"channel": "/dev/no_such"}, r"no CAN bus /dev/no_such \(slcan\)"),
     (("5",), {"bitrate": 20000}, "SYNC and two PDOs take up to 13 ms, longer than sample_period, 10 ms"),
     (("5", "408", "0x6301:1"), {}, "node 5 refuses object 0x6301:01"),
     (("5", "408", "0x1800:2"), {}, "node 5 refuses 1 in object 0x1800:02")],
)  # fmt: skip
def test_a_wrong_bus_or_node_is_named(words, changes, said):
    with (
        device("valve_408", *words) as valve,
        pytest.raises((DriverError, ParameterError), match=said),
        closing(driver(valve, **changes)) as made,
    ):
        made.open()
        made.read()
        made.enable(True)


def test_counts_and_modes_that_the_user_gives_or_leaves(valve):
    made = driver(valve, reference=8192, device_mode=0, watchdog=0.0, heartbeat=0.0)
    made.open()
    made._node.put(0x6311, 1, "h", -1)
    made.enable(True)
    until(lambda: (made.write(20.0), made.read(), made._node.get(0x6300, 1, "h"))[2] == 1638, "20 % of 8192")
    assert made._node.get(0x6042, 0, "b") == 0 and made._node.get(0x6043, 0, "b") == 1
    made.close()
    with pytest.raises(DriverError, match="node 5 has -1 in 0x6311:01; set canopen.reference"):
        driver(valve).open()


def test_a_valve_that_answers_no_more_before_it_is_enabled_loses_readings_and_then_the_device(valve):
    made = driver(valve, sdo_timeout=0.1)
    made.open()
    assert made.read() is not None
    valve.order("bus_off 1")
    with pytest.raises(DriverError, match="node 5 does not answer for object 0x6301:01"):
        while True:
            assert made.read() is None
    valve.order("bus_off 0")
    made.close()
    made.close()


def test_an_adapter_that_is_pulled_out_is_told():
    with device("valve_408", "5", "408", "", str(PERIOD)) as valve:
        made = driver(valve)
        made.open()
        activate(made, valve)
    with pytest.raises(DriverError, match="the CAN bus"):
        for _ in range(50):
            made.read()
    made.close()


def test_the_way_to_active_passes_every_state_and_a_fault_is_reset_by_an_edge():
    following = {states.DISABLED: 0b1001, states.HOLD: 0b1011, states.ACTIVE: 0b1111}
    status, passed = 0b1000, []
    while not states.active(status):
        status = following[states.towards_active(status)]
        passed.append(states.state(status))
    assert passed == ["DISABLED", "HOLD", "ACTIVE"] and states.towards_active(status) == states.ACTIVE
    for status in (0b0000, 0b0001, 0b0011):
        assert states.fault(status) and states.towards_active(status) == states.DISABLED
        first, second = states.reset(status, False), states.reset(status, True)
        assert not first & states.RESET and second & states.RESET and first & 7 == second & 7 == status & 3
