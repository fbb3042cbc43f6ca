"""The study of what a fast valve buys: its measures on systems whose answer is known, and its axes."""

import math

import numpy as np
import pytest
import scipy.signal

from valve_control.axis import study
from valve_control.cli import main
from valve_control.parameters import axis as parameters


class Known:
    """In place of a ``study.Axis``: a transfer function, which oscillates from a ``limit`` of the gain on."""

    at, speed = 0.2, 1.0

    def __init__(self, numerator, denominator, limit=37.0):
        self.filter = scipy.signal.cont2discrete((numerator, denominator), study.PERIOD, "bilinear")
        self.limit = limit

    def follow(self, gain, goals):
        x = self.at + scipy.signal.lfilter(self.filter[0].ravel(), self.filter[1], goals[:, 0] - self.at)
        if gain > self.limit:
            x = x + 0.01 * np.sin(60.0 * np.arange(len(x)) * study.PERIOD)
        return None, x


@pytest.mark.parametrize("corner", [1.3, 6.0, 20.0])
def test_the_bandwidth_of_a_first_order_lag_is_its_corner(corner):
    found = study.bandwidth(Known([1.0], [1.0 / (2.0 * math.pi * corner), 1.0]), 10.0)
    assert found == pytest.approx(corner, rel=0.03)


def test_the_bandwidth_of_a_resonance_is_where_its_phase_is_90_degrees():
    w = 2.0 * math.pi * 8.0
    assert study.bandwidth(Known([w * w], [1.0, 0.4 * w, w * w]), 10.0) == pytest.approx(8.0, rel=0.03)


@pytest.mark.parametrize("limit", [3.0, 37.0, 200.0])
def test_the_largest_gain_is_the_one_before_it_oscillates(limit):
    lag = Known([1.0], [0.02, 1.0], limit)
    assert 0.98 * limit <= study.largest_gain(lag) <= limit


def test_every_axis_of_the_box_can_move_and_is_the_same_again():
    for seed in range(50):
        values = study.random_axis(seed)
        assert values == study.random_axis(seed)
        out, into = parameters.velocity_gains(parameters.axis_params(values), values)
        assert 0.02 < into < out < 0.2


def test_the_servo_is_the_fastest_of_the_valves():
    servo, slow = (study.valve_settings(name) for name in ("servo", "open_loop"))
    assert servo["valve_simulator"]["denominator"][2] == pytest.approx((2.0 * math.pi * 100.0) ** 2)
    assert servo["valve_simulator"]["friction.coulomb"] == 0.0
    assert slow["valve_simulator"]["valve"] == "fourth_order"
    assert slow["valve_simulator"]["friction.coulomb"] > 0.0


def test_what_cannot_be_studied_is_refused(capfd, tmp_path):
    for arguments in (["--axes", "0"], ["--threads", "0"], ["--references", str(tmp_path)]):
        assert main(["axes", *arguments]) == 2
        assert capfd.readouterr().err.count("\n") == 1
