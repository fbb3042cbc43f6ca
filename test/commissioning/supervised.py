# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A bench without ROS: the real supervisor with the simulated valve, sample by sample."""

import numpy as np

from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision.record import Mode
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.design.commissioning import courses, small_signal, statics
from valve_control.design.commissioning.bench import Fault, Record, Seen
from valve_control.design.commissioning.plan import limiting
from valve_control.design.commissioning.watch import Watch
from valve_control.parameter import ParameterError, defaults, updated


class Steps:
    """Goes on with each step, or as long as ``answers`` say so, and keeps what is said."""

    def __init__(self, answers=None):
        self.answers, self.asked, self.told, self.valve, self.refusals = answers, [], [], None, []

    def confirm(self, text):
        self.asked.append(text)
        return self.answers is None or (bool(self.answers) and self.answers.pop())

    def progress(self, *progress):
        self.told.append(progress)

    def found(self, valve):
        self.valve = valve

    def refused(self, changes, reason):
        self.refusals.append((changes, reason))


class SupervisedValve:
    def __init__(self, plant=None, controller=None, fault_at=None):
        self.plant = updated(VALVE, defaults(VALVE), plant or {})
        self.controller = updated(CONTROLLER, defaults(CONTROLLER), controller or {})
        self.supervisor = Supervisor()
        self.supervisor.apply(self.controller, build.law_params(self.controller))
        self.params = build.valve_params(self.plant)
        self.state = valve.initial(self.params)
        self.random = np.random.default_rng(int(self.plant["seed"]))
        self.voltages, self.readings, self.applied = [], [], []
        self.active = True
        self.late = 1  # samples from one command to the next
        self.fault_at = fault_at
        self.fault = Fault

    def sample(self):
        reading = valve.read(self.params, self.state, float(self.random.standard_normal()))
        voltage = self.supervisor.sample(reading) if self.active else 0.0
        self.readings.append(reading)
        self.voltages.append(voltage)
        self.state = valve.step(self.params, self.state, voltage)
        if self.fault_at is not None and len(self.readings) >= self.fault_at:
            self.fault_at = None
            raise self.fault("the test wants it")
        return reading, voltage

    def values(self):
        return dict(self.controller)

    def apply(self, changes):
        try:
            values = updated(CONTROLLER, self.controller, changes)
            params = build.law_params(values)
        except ParameterError as error:
            raise Fault(str(error)) from error
        self.controller = values
        self.applied.append(dict(changes))
        self.supervisor.apply(values, params)

    def drive(self, course, limits, told):
        readings, voltages, commands = [], [], []
        command = next(course)
        period = self.params.period
        watch = Watch(limits)
        while True:
            if len(readings) % self.late == 0:
                limited = max(-10.0, min(10.0, command))
            self.supervisor.command(limited)
            reading, voltage = self.sample()
            watch.reading(reading)
            watch.voltage(voltage)
            watch.diagnosis(self.supervisor.mode is Mode.SAFE, self.supervisor.reason)
            readings.append(reading)
            voltages.append(voltage)
            commands.append(limited)
            told(len(readings) * period)
            try:
                command = course.send(Seen(len(readings) * period, reading))
            except StopIteration:
                return Record(period, np.array(readings), np.array(voltages), np.array(commands))

    def watch(self, limits):
        self.supervisor.command(0.0)
        _, voltage = self.sample()
        Watch(limits).voltage(voltage)

    def on(self):
        if not self.active:
            self.supervisor.start()
        self.active = True

    def off(self):
        self.active = False


def driven(bench, limits):
    """Rest, slow triangle and its statics, plan and record of the stepped sine, as commission makes them."""

    def silent(done):
        pass

    bench.apply(limiting(bench.values(), limits))
    rest = statics.at_rest(bench.drive(courses.rest(2.0), limits, silent))
    slow = bench.drive(courses.triangle(limits, 1.6, 4), limits, silent)
    static = statics.slow(slow, rest, limits)
    planned = small_signal.plan(limits, rest, static, 0.001)
    course = courses.stepped_sine(limits, planned.steps, planned.amplitude, planned.offset)
    return rest, slow, static, planned, bench.drive(course, limits, silent)
