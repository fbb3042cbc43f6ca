# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A CiA 408 valve on a canopen.LocalNode behind an slcan adapter; faults are ordered on standard input.

Its spool is the package's simulated valve, one sample for each SYNC. It exchanges the PDOs as they were
mapped, and watches its set point if it was told to.
"""

import math
import struct
import sys
import threading
import time

import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from slcan_adapter import Adapter
from spool import Spool

REFERENCE = 16384
U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
I8, I16 = datatypes.INTEGER8, datatypes.INTEGER16
OBJECTS = {
    0x1000: [(0, U32, 408)], 0x1016: [(1, U32, 0)], 0x1017: [(0, U16, 0)],
    0x1400: [(1, U32, 0x80000200), (2, U8, 255), (5, U16, 0)],
    0x1600: [(0, U8, 0), (1, U32, 0), (2, U32, 0)],
    0x1800: [(1, U32, 0x80000180), (2, U8, 255)],
    0x1A00: [(0, U8, 0), (1, U32, 0), (2, U32, 0)],
    0x6040: [(0, U16, 0)], 0x6041: [(0, U16, 8)], 0x6042: [(0, I8, 0)], 0x6043: [(0, I8, 2)],
    0x6300: [(1, I16, 0)], 0x6301: [(1, I16, 0)], 0x6311: [(1, I16, REFERENCE)],
}  # fmt: skip
NAMES = {0b1000: "INIT", 0b1001: "DISABLED", 0b1011: "HOLD", 0b1111: "ACTIVE", 0b0001: "FAULT"}


def dictionary(profile):
    od = canopen.ObjectDictionary()
    for index, entries in OBJECTS.items():
        single = len(entries) == 1 and entries[0][0] == 0
        record = None if single else ODRecord(f"{index:04X}", index)
        for sub, kind, default in entries:
            entry = ODVariable(f"{index:04X}:{sub}", index, sub)
            entry.data_type, entry.access_type = kind, "rw"
            entry.default = profile if index == 0x1000 else default
            if single:
                od.add_object(entry)
            else:
                record.add_member(entry)
        if not single:
            od.add_object(record)
    return od


class Valve:
    def __init__(self, node, profile, refused, period):
        self.bus = Adapter()
        self.network = canopen.Network(self.bus)
        self.network.NOTIFIER_CYCLE = 0.01
        self.node = canopen.LocalNode(node, dictionary(profile))
        if refused:
            for one in refused.split(","):
                index, sub = one.split(":")
                del self.node.object_dictionary[int(index, 16)].subindices[int(sub)]
        self.network.connect()
        self.network.add_node(self.node)
        self.node.add_write_callback(self.written)
        self.network.subscribe(0x80, self.on_sync)
        self.network.subscribe(0x200 + node, self.on_setpoint)
        self.network.subscribe(0x700 + 127, self.on_master)
        self.master = math.inf
        self.period = period
        self.spool = Spool(period)
        self.state, self.control, self.waiting = 0b1000, 0, None
        self.enabled = True  # its enable input
        self.drop, self.local = 0, 0
        self.heard = time.monotonic()
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def number(self, index, sub, form="<H"):
        return struct.unpack(form, self.node.get_data(index, sub))[0]

    def store(self, index, sub, form, value):
        self.node.set_data(index, sub, struct.pack(form, value))

    def written(self, index, subindex, od, data):
        if index == 0x6040:
            self.step(struct.unpack("<H", data)[0])

    def step(self, word):
        """The state machine: every transition between the present and the requested state is made."""
        if self.state & 8:
            wanted = {1: 0b1001, 3: 0b1011, 7: 0b1111}.get(word & 7, 0b1000)
            self.state = wanted if self.enabled else min(wanted, 0b1001)
        elif word & 8 and not self.control & 8:
            self.state = 0b1001
        self.control = word

    def fail(self, code):
        self.state = 0b0001
        self.node.emcy.send(code, 0x01)

    def on_setpoint(self, identifier, data, stamp):
        if self.node.nmt.state != "OPERATIONAL" or self.number(0x1400, 1, "<I") != 0x40000000 | identifier:
            return
        self.heard = time.monotonic()
        self.waiting = bytes(data)
        if self.number(0x1400, 2, "<B") > 240:
            self.apply()

    def on_master(self, identifier, data, stamp):
        self.master = time.monotonic()

    def apply(self):
        data, self.waiting = self.waiting, None
        for sub in range(1, self.number(0x1600, 0, "<B") + 1):
            mapped = self.number(0x1600, sub, "<I")
            assert mapped & 0xFF == 16
            self.node.set_data(mapped >> 16, mapped >> 8 & 0xFF, data[:2])
            data = data[2:]

    def on_sync(self, identifier, data, stamp):
        if self.node.nmt.state != "OPERATIONAL":
            return
        if self.waiting is not None:
            self.apply()
        self.store(0x6041, 0, "<H", self.state | self.local)
        self.store(0x6301, 1, "<h", round(self.spool.sample(self.volts()) / 10.0 * REFERENCE))
        if self.drop:
            self.drop -= 1
        elif self.number(0x1800, 1, "<I") == 0x40000180 | self.node.id and self.number(0x1800, 2, "<B") == 1:
            mapped = [self.number(0x1A00, sub, "<I") for sub in range(1, self.number(0x1A00, 0, "<B") + 1)]
            sent = b"".join(self.node.get_data(entry >> 16, entry >> 8 & 0xFF) for entry in mapped)
            self.network.send_message(0x180 + self.node.id, sent)

    def volts(self):
        if self.state != 0b1111 or self.number(0x6042, 0, "<b") != 1 or self.number(0x6043, 0, "<b") != 1:
            return 0.0
        return self.number(0x6300, 1, "<h") / REFERENCE * 10.0

    def watch(self):
        """Watch set point and heartbeat, as 0x1400:05 and 0x1016:01 say."""
        while True:
            time.sleep(0.005)
            limit = self.number(0x1400, 5) / 1000.0 if 5 in self.node.object_dictionary[0x1400] else 0.0
            if limit and self.state == 0b1111 and time.monotonic() > self.heard + limit:
                self.fail(0x8250)
            beat = self.number(0x1016, 1, "<I") if 1 in self.node.object_dictionary[0x1016] else 0
            if (
                beat >> 16 == 127
                and self.state == 0b1111
                and time.monotonic() > self.master + beat % 65536 / 1e3
            ):
                self.fail(0x8130)

    def order(self, word, value):
        if word == "emergency":
            self.node.emcy.send(int(value, 16), 0x01)
        elif word == "quiet_fault":
            self.state = 0b0001
        elif word == "local":
            self.local = 0x10 * int(value)  # 1: its own control word (0x604F) counts
        elif word == "drop":
            self.drop = int(value)
        elif word == "mute":
            self.node.nmt.stop_heartbeat()
        elif word == "stop":
            self.node.nmt.state = "PRE-OPERATIONAL"
        elif word == "bus_off":
            self.bus.bus_off = value == "1"
        elif word == "enable":
            self.enabled = value == "1"
            self.step(self.control)
        elif word == "reset":
            self.node.data_store.clear()
            self.spool = Spool(self.period)
            self.state, self.control, self.local = 0b1000, 0, 0
            self.node.nmt.stop_heartbeat()
            self.node.nmt.state = "INITIALISING"
            self.node.nmt.state = "PRE-OPERATIONAL"


def main(node="5", profile="408", refused="", period="0.001"):
    valve = Valve(int(node), int(profile), refused, float(period))
    threading.Thread(target=valve.watch, daemon=True).start()
    print(valve.bus.serialPortOrig.name, flush=True)
    for line in sys.stdin:
        word, _, value = line.strip().partition(" ")
        valve.order(word, value)
        print(f"{NAMES.get(valve.state, valve.state)} {valve.volts():.4f} {valve.node.nmt.state}", flush=True)


main(*sys.argv[1:])
