# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A valve behind analogue I/O on Modbus TCP: pymodbus's server on loopback, faults are ordered on stdin.

One unit (1): input register 3 is the LVDT, holding register 5 the amplifier, coil 7 its enable; ±32767 counts
are ±10 V. Each reading is one sample of the simulated valve. A third argument is the watchdog [s]: without a
request for so long the output is off, as couplers do it.
"""

import asyncio
import logging
import math
import sys
import time

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from spool import Spool

COUNTS = 3276.7  # per volt
LVDT, AMPLIFIER, ENABLE = 3, 5, 7


class Io:
    def __init__(self, period, watchdog):
        self.period, self.watchdog = period, watchdog
        self.heard = 0.0
        self.reset()

    def reset(self):
        self.spool = Spool(self.period)
        self.volts, self.on = 0.0, False
        self.fault = "none"  # or silent, refuse_read N, refuse_write N, refuse_voltage N, busy TIMES

    async def action(self, function, start, address, count, registers, values):
        what, _, code = self.fault.partition(" ")
        if what != "silent":
            self.heard = time.monotonic()
        if what == "silent":
            await asyncio.sleep(3600.0)
        if (what, function) in (("refuse_read", 4), ("refuse_write", 6)):
            return ExcCodes(int(code))
        if what == "refuse_voltage" and function == 6 and values and values[0]:
            return ExcCodes(int(code))
        if what == "busy" and function in (5, 6) and int(code):
            self.fault = f"busy {int(code) - 1}"
            return ExcCodes.DEVICE_BUSY
        if function == 4:
            reading = self.spool.sample(self.volts if self.on else 0.0)
            registers[LVDT - start] = round(reading * COUNTS) & 0xFFFF
        elif function == 6 and values is not None:  # called again for the answer, without values
            self.volts = (values[0] - (values[0] >> 15 << 16)) / COUNTS
        elif function == 5 and values is not None:
            self.on = bool(values[0])
        return None

    async def watch(self):
        while True:
            await asyncio.sleep(0.005)
            if time.monotonic() > self.heard + self.watchdog:
                self.volts, self.on = 0.0, False


async def main(port, period, watchdog=math.inf):
    io = Io(period, watchdog)
    watching = asyncio.create_task(io.watch())

    def registers(address):
        return [SimData(address, values=0, datatype=DataType.REGISTERS)]

    def bits():
        return [SimData(0, values=[False] * 16, datatype=DataType.BITS)]

    simdata = (bits(), bits(), registers(AMPLIFIER), registers(LVDT))
    server = ModbusTcpServer(SimDevice(1, simdata=simdata, action=io.action), address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    print(server.transport.sockets[0].getsockname()[1], flush=True)
    orders = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(orders), sys.stdin
    )
    while line := await orders.readline():
        order = line.decode().strip()
        if order == "reset":
            io.reset()
        elif order != "state":
            io.fault = order
        print(f"{io.volts:.4f} {int(io.on)}", flush=True)
    watching.cancel()


logging.getLogger("pymodbus").addHandler(logging.NullHandler())
asyncio.run(main(int(sys.argv[1]), *map(float, sys.argv[2:])))
