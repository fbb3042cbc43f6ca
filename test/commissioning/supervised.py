# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The bench without ROS, with faults on demand, and steps that record."""

from benchmarks import supervised
from valve_control.design.commissioning import courses, evaluation, valve_fit
from valve_control.design.commissioning.bench import Fault


class Steps:
    """Goes on with each step, or as long as ``answers`` say so, and records questions and reports."""

    def __init__(self, answers=None):
        self.answers, self.asked, self.reports, self.valve, self.refusals = answers, [], [], None, []
        self.records = {}

    def confirm(self, text):
        self.asked.append(text)
        return self.answers is None or (bool(self.answers) and self.answers.pop())

    def progress(self, *progress):
        self.reports.append(progress)

    def tested(self, records):
        self.records = dict(records)

    def fitted(self, valve):
        self.valve = valve

    def refused(self, changes, reason):
        self.refusals.append((changes, reason))


class SupervisedValve(supervised.SupervisedValve):
    """With a fault at the sample ``fault_at``."""

    def __init__(self, plant=None, controller=None, fault_at=None):
        super().__init__(plant, controller)
        self.fault_at = fault_at
        self.fault = Fault

    def sample(self):
        both = super().sample()
        if self.fault_at is not None and len(self.readings) >= self.fault_at:
            self.fault_at = None
            raise self.fault("the test wants it")
        return both


def driven(bench, limits):
    """Rest, slow triangle and its statics, plan and record of the stepped sine, as commission makes them."""

    def silent(done):
        pass

    bench.apply(limits.applied(bench.values()))
    rest = evaluation.at_rest(bench.drive(courses.rest(2.0), limits, silent))
    slow = bench.drive(courses.triangle(limits, 1.6, 4), limits, silent)
    static = evaluation.slow(slow, rest)
    planned = evaluation.plan(limits, static, 0.001)
    course = courses.stepped_sine(limits, planned.steps, planned.amplitude, planned.offset)
    return rest, slow, static, planned, bench.drive(course, limits, silent)


def fitted(bench, limits, tell=lambda: None):
    """What commissioning fits to the readings of ``bench``."""
    rest, slow, static, planned, sine = driven(bench, limits)
    _, fits, friction = evaluation.linear(sine, planned, static, rest)
    return valve_fit.fitted([slow, sine], fits, friction, static.offset, rest, tell)
