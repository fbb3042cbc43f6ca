# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The study of what a fast valve buys, its measures and axes; the Delta case by its published errors."""

import json
import math

import pytest
import scipy.optimize
import scipy.signal

from research.axes import delta, study
from research.delta import main
from valve_control.axis import axis_parameters as parameters
from valve_control.axis import run


def test_every_axis_of_the_box_can_move_and_is_the_same_again():
    for seed in range(50):
        values = study.random_axis(seed)
        assert values == study.random_axis(seed)
        out, into = parameters.velocity_gains(parameters.axis_params(values), values)
        assert 0.02 < into < out < 0.2


class Driven:
    """In place of a ``study.Axis``: a valve of second order before an integrator, whose reach is known."""

    speed, gain, w = 0.1, 0.01, 2.0 * math.pi * 5.0  # m/s, m/s/V, rad/s

    def driven(self, voltages):
        system = ([self.gain * self.w**2], [1.0, 1.4 * self.w, self.w**2, 0.0])
        b, a, _ = scipy.signal.cont2discrete(system, study.PERIOD, "zoh")
        return scipy.signal.lfilter(b.ravel(), a, voltages)


def test_the_reach_is_where_the_whole_voltage_makes_the_sine_at_minus_3_db():
    """4/π·u_max·|G| against the sine; only 0.25 of the speed counts, so both fall with 1/f from it."""
    axis, u_max = Driven(), 10.0

    def left(f):
        valve = 1.0 / abs(1.0 - (2.0 * math.pi * f / axis.w) ** 2 + 1.4j * 2.0 * math.pi * f / axis.w)
        made = 4.0 / math.pi * u_max * axis.gain * valve / (2.0 * math.pi * f)
        return made - math.sqrt(0.5) * study.sine_amplitude(axis.speed, f)

    expected = scipy.optimize.brentq(left, 3.0, 60.0)
    assert 8.0 < expected < 20.0
    assert study.reach(axis, u_max) == pytest.approx(expected, rel=0.03)
    assert study.reach(axis, 100.0 * u_max) == study.FREQUENCIES[-1]


def test_no_law_gets_a_slow_valve_as_far_as_a_servo_valve():
    """Axis 2 of the study: at 10 V the spool of the slow valve does not move far enough."""
    values = study.random_axis(2)
    slow, servo = (run.setup(study.valve_settings(name)) for name in ("dcarc", "servo"))
    ends = [study.reach(study.Axis(base, values), base.machine.valve.u_max) for base in (slow, servo)]
    assert 14.8 < ends[0] < 22.0 and ends[1] == study.FREQUENCIES[-1]
    assert study.reach(study.Axis(slow, values), 2.0 * slow.machine.valve.u_max) == ends[0]  # the amplifier's


@pytest.mark.campaign
def test_the_published_figures_come_out_and_a_servo_valve_loses_next_to_nothing():
    """About 0.002 mm with exact parameters, about 0.07 mm with all of them 10 % low."""
    alone = delta.published(delta.Case(delta.NONE))
    assert 0.001e-3 < alone.nominal < 0.006e-3
    assert alone.low == pytest.approx(0.07e-3, rel=0.05)
    servo = delta.published(delta.Case("servo"))
    assert servo.worst < 1.2 * alone.worst and servo.restless < 1e-6
    assert len(servo.corners) == 8 and servo.corners[0] == servo.low


@pytest.mark.campaign
def test_with_dcarc_the_slow_valve_is_ten_times_nearer_than_as_delivered(tmp_path, capfd):
    assert main(["--json", str(tmp_path / "d.json")]) == 0
    found = json.loads((tmp_path / "d.json").read_text())["valves"]
    worst = {name: max(results["own"]["corners"]) for name, results in found.items()}
    assert worst["servo"] < worst["dcarc"] < worst["pid"] < worst["open_loop"]
    assert worst["dcarc"] < 0.1 * worst["open_loop"]
