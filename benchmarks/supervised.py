# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A bench of a commissioning without ROS: the real supervisor with a simulated valve, sample by sample."""

from collections.abc import Mapping

import numpy as np

from valve_control.control.compiling import compile_function
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import registry
from valve_control.control.supervision.memory import Mode
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.control.supervision.trajectory import Motion
from valve_control.design.commissioning.bench import (
    Course,
    Diagnosis,
    Elapsed,
    Fault,
    Instant,
    Pause,
    Point,
    Record,
    SafetyLimits,
    Watch,
)
from valve_control.parameter import ParameterError, Value, Values, defaults, updated


class SupervisedValve:
    """Controller with its supervisor, and the valve, as ``commissioning.bench.Bench`` wants them."""

    def __init__(
        self, plant: Mapping[str, Value] | None = None, controller: Mapping[str, Value] | None = None
    ) -> None:
        """Bring both to rest; what is not given is the default.

        Raises ParameterError.
        """
        self.plant = updated(VALVE, defaults(VALVE), plant or {})
        self.controller = updated(CONTROLLER, defaults(CONTROLLER), controller or {})
        self.supervisor = Supervisor()
        self.supervisor.apply(self.controller, build.law_params(self.controller))
        self.params = build.valve_params(self.plant)
        kind = registry.plant_of(self.params)
        self.state = kind.module.initial(self.params)
        self._read, self._step = kind.module.read, kind.module.step
        if kind.compiled:
            self._read, self._step = compile_function(self._read), compile_function(self._step)
        self.random = np.random.default_rng(int(float(str(self.plant["seed"]))))
        self.voltages: list[float] = []
        self.readings: list[float] = []
        self.applied: list[dict[str, Value]] = []
        self.active = True

    def sample(self) -> tuple[float, float]:
        """One reading [V] and the voltage [V] that answers it."""
        reading = float(self._read(self.params, self.state, float(self.random.standard_normal())))
        voltage = self.supervisor.sample(reading) if self.active else 0.0
        self.readings.append(reading)
        self.voltages.append(voltage)
        self.state = self._step(self.params, self.state, voltage)
        return reading, voltage

    def values(self) -> Values:
        """All parameters of the controller."""
        return dict(self.controller)

    def apply(self, changes: Mapping[str, Value]) -> None:
        """Set all ``changes`` or none. Raises Fault if they are refused."""
        try:
            values = updated(CONTROLLER, self.controller, changes)
            params = build.law_params(values)
        except ParameterError as error:
            raise Fault(str(error)) from error
        self.controller = values
        self.applied.append(dict(changes))
        self.supervisor.apply(values, params)

    def drive(self, course: Course, limits: SafetyLimits, elapsed: Elapsed) -> Record:
        """Give the commands of ``course`` until it ends. Raises Fault as the bench over ROS does."""
        readings: list[float] = []
        voltages: list[float] = []
        commands: list[float] = []
        command = next(course)
        period = self.params.period
        watch = Watch(limits)

        def record() -> Record:
            return Record(period, np.array(readings), np.array(voltages), np.array(commands))

        while True:
            limited = command.position if isinstance(command, Point) else max(-10.0, min(10.0, command))
            if isinstance(command, Point):
                self.supervisor.trajectory(Motion(*command))
            else:
                self.supervisor.command(limited)
            reading, voltage = self.sample()
            watch.reading(reading)
            watch.voltage(voltage)
            supervisor = self.supervisor
            safe, conditions = supervisor.mode is Mode.SAFE, frozenset(supervisor.conditions)
            try:
                watch.diagnosis(Diagnosis(safe, True, conditions, supervisor.reason))
            except Pause as pause:
                raise Pause(str(pause), record()) from pause
            readings.append(reading)
            voltages.append(voltage)
            commands.append(limited)
            elapsed(len(readings) * period)
            try:
                command = course.send(Instant(len(readings) * period, reading))
            except StopIteration:
                return record()

    def watch(self, limits: SafetyLimits) -> None:
        """Look at one more sample. Raises Fault."""
        self.supervisor.command(0.0)
        _, voltage = self.sample()
        Watch(limits).voltage(voltage)

    def on(self) -> None:
        """Let the controller work."""
        if not self.active:
            self.supervisor.start()
        self.active = True

    def off(self) -> None:
        """Give 0 V."""
        self.active = False
