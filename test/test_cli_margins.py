# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""`margins`, and the sentences about unstable loops: they say the way in which the loop becomes stable."""

import json

import numpy as np
import pytest

from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import linear_loop, stability
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, faster
from valve_control.parameter import defaults, updated

CONTROL = defaults(CONTROLLER)
SHARP = {"pid.form": "plain", "pid.kp": 10.0, "pid.ki": 940.0, "pid.kd": 0.07}
SLOW = {"pid.form": "plain", "pid.kp": 1.0, "pid.ki": 300.0, "pid.kd": 0.0}


def plant(gain, speed):
    model = faster(FOURTH_ORDER, gain, speed)
    own = {"valve": "custom", "numerator": list(model.numerator), "denominator": list(model.denominator)}
    return build.valve_params(updated(VALVE, defaults(VALVE), own))


@pytest.mark.parametrize(
    ("gains", "speed", "way"),
    [(SHARP, 0.5, "raise the gains"), ({}, 0.2, "lower the gains"), (SLOW, 0.3, "lower the gains")],
)
def test_an_unstable_loop_is_stable_when_its_gain_goes_the_way_that_is_said(gains, speed, way):
    law = LAWS["pid"]
    params = law.build(updated(CONTROLLER, defaults(CONTROLLER), gains))
    text = stability.valve_warning(law, params, plant(0.5, speed), CONTROL)
    assert way in text and "unstable on this valve" in text
    down, up = stability.stable_gains(law, params, linear_loop.linear_valves([plant(0.5, speed)]))
    change = up if way.startswith("raise") else -down
    assert f"stable with {abs(change)} dB" in text
    for decibel, stable in ((change, True), (change - change // abs(change), False)):
        there = plant(0.5 * 10.0 ** (decibel / 20.0), speed)
        assert (stability.valve_warning(law, params, there, CONTROL) == "") == stable


def test_margins_shrink_by_what_the_valve_takes_of_them(run):
    def told(*options):
        status, out, err = run("margins", "--controller", "arc", "--json", "-", *options)
        assert status == 0, err
        return json.loads(out)["margins"], err

    usual = told()[0]["this valve"]
    louder = told("--set", "gain_scale=1.25")[0]["this valve"]
    assert louder["gain_db"] == pytest.approx(usual["gain_db"] - 20.0 * np.log10(1.25), abs=0.05)
    later = told("--set", "lvdt.delay=0.001")[0]["this valve"]
    assert later["delay_s"] == pytest.approx(usual["delay_s"] - 0.001, abs=5e-5)
    over, _ = told("--box", "--fix", "lvdt.noise")
    worst = over["worst of 48 valves of the box"]
    assert worst["gain_db"] < usual["gain_db"] and worst["delay_s"] < usual["delay_s"]
    broken, err = told("--set", "gain_scale=30.0")
    assert broken["this valve"]["gain_db"] == 0.0 and "lower the gains" in err


CURVED = {
    "valve": "solenoid",
    "solenoid.overlap": 0.3,
    "solenoid.positive": 1.1,
    "solenoid.negative": 0.9,
    "solenoid.coil": 0.0005,
}


def curve(positive, negative, null=0.3):
    """Static curve with the slope 0.05 across the overlap, and these gains beside it."""
    edge = 0.05 * null
    return {
        "linearisation.enabled": True,
        "linearisation.voltage": [-10.0, -null, null, 10.0],
        "linearisation.position": [
            -edge - negative * (10.0 - null),
            -edge,
            edge,
            edge + positive * (10.0 - null),
        ],
    }


def test_behind_the_inverse_of_its_own_curve_a_valve_has_one_gain():
    """Overlap and unequal gains are gone, but for what the slope 0.05 leaves of the flat part."""
    valve = build.valve_params(updated(VALVE, defaults(VALVE), CURVED))
    values = updated(CONTROLLER, CONTROL, curve(1.1, 0.9))
    weak, strong = (p.spool.gain / valve.spool.gain for p in stability.behind_curve(values, valve))
    assert 0.85 < weak < strong < 1.001
    assert stability.behind_curve(CONTROL, valve) == [valve]


def test_margins_and_warnings_take_the_curve_into_account(run):
    """A curve of 0.8 times the valve's gain makes the gain of the loop 1.25 times as large."""

    def told(*options):
        status, out, err = run("margins", "--controller", "arc", "--json", "-", *options)
        assert status == 0, err
        return json.loads(out)["margins"]["this valve"], err

    def given(slope):
        ends = f"[{-10.0 * slope!r}, {10.0 * slope!r}]"
        return ("--set", "linearisation.enabled=true", "--set", f"linearisation.position={ends}")

    usual, err = told()
    assert "unstable" not in err
    halved, _ = told(*given(0.8))
    assert halved["gain_db"] == pytest.approx(usual["gain_db"] + 20.0 * np.log10(0.8), abs=0.05)
    assert "unstable on this valve" in told(*given(0.02))[1]
    assert "unstable on this valve" in run("simulate", "--controller", "arc", *given(0.02))[2]
