# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the nodes `valve_simulator` and `axis_simulator`: a valve, the axis that it feeds, their sensors."""

import math
import sys
from collections.abc import Sequence
from time import monotonic
from typing import Any

import numpy as np
from sensor_msgs.msg import FluidPressure, JointState

from valve_control.arrays import Floats
from valve_control.axis import axis, machine
from valve_control.axis import axis_parameters as parameters
from valve_control.axis.axis_parameters import AXIS
from valve_control.control.compiling import compile_function
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import valve
from valve_control.nodes.adapter import SAMPLES, ParameterSet, admit
from valve_control.nodes.loop import Worker, run
from valve_control.nodes.valve_simulator import ValveSimulator
from valve_control.parameter import ParameterError, Values, number, word

NANO = 10**9
LEAP = 0.1  # of the stroke, a position that jumps
BEYOND = 1.5  # times the stroke, a position out of range
HIGH = 1e8  # Pa, a pressure that jumps


class AxisSimulator(Worker):
    """Publishes `joint_states`, `pressure_a` and `pressure_b`, once per reading of the valve's LVDT.

    It has the parameters of the axis; the valve that feeds it is a node of its own, with the parameters,
    faults, clock and life of `valve_simulator`.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("axis_simulator", **options)
        self._values: Values = {}
        self._axis: axis.Params
        self._sensors: machine.Sensors
        self._machine: machine.Params
        self._state: machine.State
        self._machine_known = False
        self._shown: float | None = None  # m  position that was published last
        self._follow = compile_function(machine.followed)
        self._joints = self.create_publisher(JointState, "joint_states", SAMPLES)
        room_a = self.create_publisher(FluidPressure, "pressure_a", SAMPLES)
        self._rooms = room_a, self.create_publisher(FluidPressure, "pressure_b", SAMPLES)
        self._joint, self._pressure = JointState(), FluidPressure()
        ParameterSet(self, AXIS, self._build, self._apply, alone=False, fixed=("sample_period",))

    def _build(self, values: Values) -> tuple[axis.Params, machine.Sensors]:
        built = parameters.axis_params(values)
        parameters.velocity_gains(built, values)
        return built, parameters.sensors(values)

    def _apply(self, values: Values, built: tuple[axis.Params, machine.Sensors]) -> None:
        anew = self._values and built[1] != self._sensors
        self._values = values
        self._axis, self._sensors = built
        self._joint.name = [word(values, "joint")]
        self._pressure.variance = number(values, "pressure.noise") ** 2
        if self._machine_known:
            self._machine = self._machine._replace(axis=self._axis, sensors=self._sensors)
            if anew:  # with other delays the history is another
                begun = machine.begin(self._machine, self._state.axis)
                self._state = begun._replace(valve=self._state.valve)

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return number(self._values, "sample_period")

    @property
    def complete(self) -> bool:
        """Whether as many listen to the position as are waited for."""
        return bool(self._joints.get_subscription_count() >= number(self._values, "listeners"))

    def rest(self, params: valve.Params) -> None:
        """Put the axis at rest at its start, fed by a valve of ``params``, and start the noise anew."""
        self._machine = machine.Params(params, self._axis, self._sensors)
        if not self._machine_known:
            self.get_logger().info("compiling the axis, some seconds at the first start ...")
        self._machine_known = True
        self._state = parameters.start(self._machine, self._values)
        self._random = np.random.default_rng(int(number(self._values, "seed")))
        tried = machine.copied(self._state)
        self._follow(self._machine, tried, tried.valve)  # compiled before the first sample

    def move(self, before: valve.State, after: valve.State) -> None:
        """Move the axis over a period, in which the valve came from ``before`` to ``after``."""
        self._state = self._follow(self._machine, self._state._replace(valve=before), after)

    def measure(self, params: valve.Params, feeding: valve.State, nanoseconds: int) -> Floats:
        """Publish the readings of a sample; returns its standard normal numbers, the first for the LVDT."""
        noise: Floats = self._random.standard_normal(machine.NOISES)
        self._machine = self._machine._replace(valve=params)
        self._state = self._state._replace(valve=feeding)
        reading = machine.read(self._machine, self._state, noise)
        self._publish_pressures(reading, nanoseconds)
        self._publish_position(reading.position, nanoseconds)
        return noise

    def _publish_pressures(self, reading: machine.Reading, nanoseconds: int) -> None:
        fault = word(self._values, "fault.pressure")
        if fault == "silent":
            return
        pressures = (reading.pressure_a, reading.pressure_b)
        for publisher, pressure in zip(self._rooms, pressures, strict=True):
            message = self._pressure
            self._stamp(message, nanoseconds)
            message.fluid_pressure = {"jump": pressure + HIGH, "not_finite": math.nan}.get(fault, pressure)
            publisher.publish(message)

    def _publish_position(self, position: float, nanoseconds: int) -> None:
        fault = word(self._values, "fault.position")
        stroke = self._axis.cylinder.stroke
        if fault == "silent":
            return
        frozen = position if self._shown is None else self._shown
        wrong = {"jump": position + LEAP * stroke, "out_of_range": BEYOND * stroke, "not_finite": math.nan}
        self._shown = position = {"frozen": frozen, **wrong}.get(fault, position)
        self._stamp(self._joint, nanoseconds)
        self._joint.position = [position]
        self._joints.publish(self._joint)

    @staticmethod
    def _stamp(message: Any, nanoseconds: int) -> None:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, NANO)


class FeedingValve(ValveSimulator):
    """The simulated valve whose edges feed an axis."""

    def __init__(self, fed: AxisSimulator, **options: Any) -> None:
        self._fed = fed
        self._row: Floats = np.zeros(machine.NOISES)
        super().__init__(alone=False, **options)

    def _build(self, values: Values) -> Any:
        period = self._fed.period
        if number(values, "sample_period") != period:
            raise ParameterError(
                f"sample_period is {period:g} s for the axis and {number(values, 'sample_period'):g} s for "
                "its valve; they must be equal"
            )
        return super()._build(values)

    def _rest(self) -> None:
        super()._rest()
        self._fed.rest(self._params)

    def _complete(self) -> bool:
        return super()._complete() and self._fed.complete

    def _advance(self) -> None:
        before = self._state
        super()._advance()
        self._fed.move(before, self._state)

    def _send(self) -> None:
        # In lockstep time goes with the samples; a sample that is made late has the time at which it was due.
        late = max(0.0, monotonic() - self._next)
        now = int(self.get_clock().now().nanoseconds) - round(late * NANO)
        time = round(self._samples * self._period * NANO) if self._lockstep else now
        self._row = self._fed.measure(self._params, self._state, time)
        super()._send()

    def _noise(self) -> float:
        return float(self._row[0])


def make() -> Sequence[Any]:
    """Create both nodes of the process."""
    fed = AxisSimulator()
    space = fed.get_namespace().rstrip("/")
    admit(fed, {fed.get_fully_qualified_name(): AXIS, f"{space}/valve_simulator": VALVE})
    return [fed, FeedingValve(fed)]


def main() -> int:
    """Entry point of `ros2 run valve_control axis_simulator`."""
    return run(make)


if __name__ == "__main__":
    sys.exit(main())
