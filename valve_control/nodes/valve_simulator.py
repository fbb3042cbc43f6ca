"""Node `valve_simulator`: stands in for amplifier, valve and LVDT."""

import math
import sys
import time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Float64

from valve_control.laws.signals import saturate
from valve_control.nodes.adapter import (
    SAMPLES,
    ParameterSet,
    PolledSubscription,
    diagnostics,
    run,
)
from valve_control.parameters import build
from valve_control.parameters.table import VALVE, Values
from valve_control.plant import valve

POLL = 5e-5  # s between two looks for a late voltage
STALL = 0.1  # s; a longer pause of the process is skipped, not made good


class ValveSimulator(Node):
    """Reads `valve_voltage`, publishes `spool_position` once per sample period.

    Samples fall on an absolute schedule: a tick that comes late makes good the samples that are due. The
    voltage of sample k acts from k to k+1. No real valve waits for a process that the operating system
    has put aside, so that the simulated one holds back sample k+1 for up to `patience`.
    """

    def __init__(self) -> None:
        super().__init__("valve_simulator")
        self._params: Any = None
        self._state: Any = None
        self._seed: int | None = None
        self._period: float | None = None
        self._timer: Any = None
        self._voltage = 0.0
        self._answered = False
        self._samples = 0
        self._counts = dict.fromkeys(("late_voltages", "voltage_refused", "samples_skipped"), 0)
        self._message = Float64()
        self._voltages = PolledSubscription(self, Float64, "valve_voltage", SAMPLES)
        self._positions = self.create_publisher(Float64, "spool_position", SAMPLES)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", SAMPLES)
        self._tuning = ParameterSet(self, VALVE, build.valve_params, self._apply)
        self.create_timer(1.0, self._diagnose)

    def _apply(self, values: Values, params: Any) -> None:
        former = self._params
        self._params = params
        self._patience = build.number(values, "patience")
        fresh = valve.initial(params)
        if self._state is None:
            self._state = fresh
        elif params.lvdt.delay != former.lvdt.delay:
            fresh.history[:] = self._state.x.x0
            self._state = self._state._replace(history=fresh.history, newest=0)
        seed = int(build.number(values, "seed"))
        if seed != self._seed:
            self._seed = seed
            self._random = np.random.default_rng(seed)
        if params.period != self._period:
            self._period = params.period
            if self._timer is not None:
                self.destroy_timer(self._timer)
            self._next = time.monotonic() + params.period
            self._timer = self.create_timer(params.period, self._tick)
            self.get_logger().info(f"{values['valve']} valve at {1.0 / params.period:g} Hz")

    def _tick(self) -> None:
        period = self._params.period
        behind = time.monotonic() - self._next
        if behind > STALL:
            skipped = int(behind / period)
            self._counts["samples_skipped"] += skipped
            self._next += skipped * period
            self.get_logger().warning(f"stood still for {behind:.3f} s, {skipped} samples skipped")
        while time.monotonic() >= self._next:
            self._sample()
            self._next += period

    def _sample(self) -> None:
        if self._samples > 0:
            self._take_voltage()
            self._state = valve.step(self._params, self._state, self._voltage)
        noise = float(self._random.standard_normal())
        self._message.data = valve.read(self._params, self._state, noise)
        self._positions.publish(self._message)
        self._samples += 1

    def _take_voltage(self) -> None:
        """Take the voltage of the sample before; wait for it if the controller answered until now."""
        arrived = self._poll_voltage()
        if not arrived and self._answered:
            limit = time.monotonic() + self._patience
            while not arrived and time.monotonic() < limit:
                time.sleep(POLL)
                arrived = self._poll_voltage()
        if not arrived:
            self._counts["late_voltages"] += 1
        self._answered = arrived

    def _poll_voltage(self) -> bool:
        arrived = False
        for message, _ in self._voltages.take():
            arrived = True
            if math.isfinite(message.data):
                self._voltage = saturate(message.data, self._params.u_max)
            else:
                self._counts["voltage_refused"] += 1
                self.get_logger().warning(
                    f"voltage {message.data} refused, the last one holds", throttle_duration_sec=1.0
                )
        return arrived

    def _diagnose(self) -> None:
        values = {
            "samples": self._samples,
            **self._counts,
            "position": f"{self._state.x.x0:.4f}",
            "voltage": f"{self._voltage:.4f}",
        }
        self._diagnostics.publish(diagnostics(self, DiagnosticStatus.OK, "simulating", values))


def main() -> int:
    """Entry point of `ros2 run valve_control valve_simulator`."""
    return run(ValveSimulator)


if __name__ == "__main__":
    sys.exit(main())
