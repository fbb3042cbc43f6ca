# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `valve_simulator`: stands in for amplifier, valve and LVDT, and for their faults."""

import math
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock as ClockMessage
from std_msgs.msg import Float64

from valve_control.control.compiling import compile_function
from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import registry
from valve_control.control.plant.saturation import saturate
from valve_control.nodes import realtime
from valve_control.nodes.adapter import (
    SAMPLES,
    Diagnostics,
    NumberSubscription,
    ParameterSet,
    acquainted,
    encoded,
)
from valve_control.nodes.lifecycle import Managed
from valve_control.nodes.loop import run
from valve_control.parameter import ParameterError, Values, number, word

POLL = 5e-5  # s between two looks for a late voltage
STALL = 0.1  # s; a longer pause of the process is skipped, not made good
MOST_AT_ONCE = 50  # samples
KNOCK = 0.01  # s between two looks whether the listeners are there
MEET = 5.0  # s; lockstep: a controller that is there has so long to become ready for readings
WAIT = 1.0  # s; lockstep: between two warnings that a reading has no answer
CORRUPT = b""  # a frame that DDS cannot read and drops: its sequence number is missing at the receiver
BEYOND = 1.5  # times u_max, a reading out of range
WEAK = 0.2  # of the gain, a weak solenoid
SLOPES = {"flipped": -1.0, "half": 0.5}  # of an LVDT
NEVER = math.inf


class ValveSimulator(Managed):
    """Reads `valve_voltage`, publishes `spool_position` once per sample period.

    clock: wall      samples fall on an absolute schedule: a tick that comes late makes good the samples that
                     are due. The voltage of sample k acts from k to k+1. No real valve waits for a process
                     that the operating system has put aside, so that the simulated one holds back sample
                     k+1 for up to `patience`.
    clock: lockstep  sample k+1 follows as soon as the voltage of sample k is there, however long it takes,
                     and `/clock` goes with the samples.

    ``alone``: whether the process has no other node.
    """

    def __init__(self, alone: bool = True, **options: Any) -> None:
        super().__init__("valve_simulator", **options)
        self._params: Any = None
        self._plant: Any = None
        self._step: Any = None
        self._state: Any = None
        self._period = 0.0
        self._next = NEVER
        self._voltage = 0.0
        self._heard = False  # whether a voltage has ever come
        self._answered = False
        self._unanswered = 0  # samples in a row
        self._samples = 0
        self._sent: float | None = None
        self._complete_since = 0.0  # lockstep: when enough listeners had come
        self._fault = ("none", "none")
        self._fault_left = 0
        self._counts = dict.fromkeys(
            ("late_voltages", "voltage_refused", "voltage_timeouts", "samples_skipped"), 0
        )
        self._clock_message = ClockMessage()
        self._diagnostics = Diagnostics(self, self._diagnose)
        ParameterSet(self, VALVE, self._build, self._apply, alone)
        for sentence in registry.LEFT_OUT.values():
            self.get_logger().warning(sentence)
        if self._values["autostart"]:
            self.autostart()

    def _build(self, values: Values) -> Any:
        if values["clock"] == "lockstep" and values["fault.lvdt"] == "lost":
            raise ParameterError(
                "fault.lvdt is lost, but in lockstep no reading can be: choose silent, or clock wall"
            )
        return build.valve_params(values)

    def _apply(self, values: Values, built: Any) -> None:
        former, self._params = self._params, built
        self._values = values
        self._patience = number(values, "patience")
        self._timeout = number(values, "voltage_timeout")
        self._listeners = int(number(values, "listeners"))
        self._lockstep = values["clock"] == "lockstep"
        before, self._plant = self._plant, registry.plant_of(self._params)
        if self._plant is not before:
            self._step = self._plant.module.step
            if self._plant.compiled:  # it is too long for plain Python
                self._step = compile_function(self._step)
                self._step(self._params, self._plant.module.initial(self._params), 0.0)
        if self._state is None or former is None:
            self._rest()
        elif self._plant is not before:
            self._state = self._plant.module.initial(self._params)
        else:
            self._state = self._plant.resumed(former, self._params, self._state)
        if values["seed"] != self._seed:
            self._sow()
        if self._params.period != self._period:
            self._period = self._params.period
            self._next = time.monotonic() + self._period
        fault = (word(values, "fault.lvdt"), word(values, "fault.valve"))
        if fault != self._fault:
            self._fault = fault
            injected = fault != ("none", "none")
            self._fault_left = int(number(values, "fault.samples")) if injected else 0
        if "weak" in fault:
            self._params = self._plant.varied(self._params, WEAK, 0.0, 1.0)

    def _sow(self) -> None:
        self._seed = int(number(self._values, "seed"))
        self._random = np.random.default_rng(self._seed)

    def _rest(self) -> None:
        """Put the spool at rest in the centre, and start the noise from its beginning."""
        self._sow()
        self._state = self._plant.module.initial(self._params)
        self._voltage = 0.0
        self._heard = self._answered = self._centring = False
        self._unanswered = self._samples = 0
        self._sent = None

    # Life

    def open(self) -> None:
        """Create publishers and subscriptions."""
        self._voltages = NumberSubscription(self, "valve_voltage", SAMPLES)
        self._positions = self.create_publisher(Float64, "spool_position", SAMPLES)
        self._clock_publisher: Any = None

    def begin(self) -> None:
        """Start from rest."""
        for _ in self._voltages.take():
            pass
        self._rest()
        self._next = 0.0
        pace = "in lockstep" if self._lockstep else f"at {1.0 / self._period:g} Hz"
        self.get_logger().info(f"{self._values['valve']} valve {pace}")

    # Work

    def inputs(self) -> Sequence[NumberSubscription]:
        """Subscription of the voltage in lockstep; on the wall clock none, the next sample is on time."""
        return (self._voltages,) if self.working and self._lockstep else ()

    def due(self) -> float:
        """Time [s] of the next sample, or in lockstep of the next look for a missing party."""
        return self._next if self.working else NEVER

    def work(self) -> bool:
        """Make the samples that are due."""
        if not self.working:
            return False
        return self._work_in_lockstep() if self._lockstep else self._work_on_the_clock()

    def _work_on_the_clock(self) -> bool:
        now = time.monotonic()
        if now < self._next:
            return False
        if self._samples == 0:
            self._next = now
        # No more at once, so that signals and services have their turn where the period is too short to keep.
        for _ in range(MOST_AT_ONCE):
            behind = time.monotonic() - self._next
            if behind < 0.0:
                break
            if behind > STALL:
                skipped = int(behind / self._period)
                self._counts["samples_skipped"] += skipped
                self._next += skipped * self._period
                self.get_logger().warning(f"fell {behind:.3f} s behind, {skipped} samples skipped")
            if self._samples > 0:
                self._take_voltage()
                self._advance()
            self._send()
            self._next += self._period
        return True

    def _work_in_lockstep(self) -> bool:
        if self._samples == 0:
            if not self._complete():
                self._next = time.monotonic() + KNOCK
                return False
        elif self._poll_voltage() or self._sent is None:
            self._advance()
        else:
            if time.monotonic() >= self._next:
                self._next = time.monotonic() + WAIT
                text = f"lockstep: no voltage for sample {self._samples} within {WAIT:g} s; waits"
                self.get_logger().warning(text)
            return False
        if self._clock_publisher is None:
            self._clock_publisher = self.create_publisher(ClockMessage, "/clock", 1)
        nanoseconds = round(self._samples * self._period * 1e9)
        self._clock_message.clock.sec, self._clock_message.clock.nanosec = divmod(nanoseconds, 10**9)
        self._clock_publisher.publish(self._clock_message)
        self._send()
        self._next = time.monotonic() + (WAIT if self._sent is not None else 0.0)
        return True

    def _complete(self) -> bool:
        """Whether all wanted listeners are there, among them a controller."""
        now = time.monotonic()
        heard = self._positions.get_subscription_count() >= self._listeners
        if not (heard and self.get_publishers_info_by_topic("valve_voltage")):
            self._complete_since = now
            return False
        return now - self._complete_since > MEET or acquainted(self, self._positions, "valve_voltage")

    def _advance(self) -> None:
        before = self._state
        self._state = self._step(self._params, before, self._voltage)
        if "stuck" in self._fault:
            self._state = self._state._replace(x=before.x._replace(x1=0.0))

    def _send(self) -> None:
        reading = self._plant.module.read(self._params, self._state, self._noise())
        fault = self._fault[0]
        if fault == "lost":
            self._positions.publish(CORRUPT)
            self._sent = None
        elif fault == "silent":
            self._sent = None
        else:
            if fault == "frozen" and self._sent is not None:
                reading = self._sent
            elif fault == "out_of_range":
                reading = math.copysign(BEYOND * self._params.u_max, reading)
            elif fault == "not_finite":
                reading = math.nan
            elif fault == "jump":
                reading += number(self._values, "fault.jump")
            elif fault in SLOPES:
                reading *= SLOPES[fault]
            self._sent = reading
            self._positions.publish(encoded(reading))
        self._samples += 1
        if self._fault_left > 0:
            self._fault_left -= 1
            if self._fault_left == 0:
                self.set_parameters([Parameter(f"fault.{part}", value="none") for part in ("lvdt", "valve")])

    def _noise(self) -> float:
        """Standard normal number for the noise of this sample's reading."""
        return float(self._random.standard_normal())

    def _take_voltage(self) -> None:
        """Take the voltage of the last sample; wait for it if the controller answered until now."""
        arrived = self._poll_voltage()
        if not arrived and self._answered and self._sent is not None:
            limit = time.monotonic() + self._patience
            while not arrived and time.monotonic() < limit:
                time.sleep(POLL)
                arrived = self._poll_voltage()
        self._answered = arrived
        if arrived:
            self._unanswered = 0
            return
        self._counts["late_voltages"] += 1
        self._unanswered += 1
        if self._heard and 0.0 < self._timeout < self._unanswered * self._period:
            self._heard = False
            self._voltage = 0.0
            self._counts["voltage_timeouts"] += 1
            self._centring = True
            self.get_logger().error(f"no voltage for {self._timeout:g} s: 0 V, the spring centres the spool")
            self._diagnose()

    def _poll_voltage(self) -> bool:
        arrived = False
        for voltage, _ in self._voltages.take():
            arrived = True
            if math.isfinite(voltage):
                self._voltage = saturate(voltage, self._params.u_max)
                self._heard = True
                self._centring = False
            else:
                self._counts["voltage_refused"] += 1
                self.get_logger().warning(
                    f"voltage {voltage} refused, the last one holds", throttle_duration_sec=1.0
                )
        return arrived

    def _diagnose(self) -> None:
        values = {
            "samples": self._samples,
            **self._counts,
            "position_V": f"{self._state.x.x0:.4f}",
            "voltage_V": f"{self._voltage:.4f}",
            "fault.lvdt": self._fault[0],
            "fault.valve": self._fault[1],
        }
        level, text = DiagnosticStatus.OK, "simulating"
        if self._centring:
            level, text = DiagnosticStatus.ERROR, "no voltage: 0 V, the spring centres the spool"
        elif self._fault != ("none", "none"):
            level, text = DiagnosticStatus.WARN, "simulating a fault"
        self._diagnostics.tell(level, text, values, realtime.obtained)


def main() -> int:
    """Entry point of `ros2 run valve_control valve_simulator`."""
    return run(lambda: [ValveSimulator()])


if __name__ == "__main__":
    sys.exit(main())
