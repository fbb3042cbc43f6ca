# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The characteristic curve: overlap, two gains, null and play of a static valve come back."""

import changed
import numpy as np
import pytest

from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant.transfer_functions import FOURTH_ORDER
from valve_control.design.identification import characteristic, experiment, friction
from valve_control.design.identification.experiment import Experiment
from valve_control.parameter import defaults, updated

PERIOD = 0.001
LAG = friction.lag_of(FOURTH_ORDER, 0.0)


def triangle(**changes):
    return build.commands(experiment.test_values({**friction.TEST, **changes}, PERIOD))


def curve_of(tested, lag):
    return characteristic.friction_and_curve(tested, lag)[1]


def played(voltage, half):
    """Play of the ``half`` width: the output rests until the input has gone through it."""
    out = np.empty_like(voltage)
    b = 0.0
    for k, u in enumerate(voltage.tolist()):
        b = min(max(b, u - half), u + half)
        out[k] = b
    return out


def with_overlap(u, low, high):
    return np.where(u > high, u - high, np.where(u < low, u - low, 0.0))


def static(positive=0.9, negative=0.9, low=0.0, high=0.0, play=0.0, noise=0.003, bias=0.0):
    """A valve without dynamics; its curve is known exactly."""
    voltage = triangle()
    force = with_overlap(played(voltage, play), low, high)
    position = np.where(force > 0.0, positive, negative) * force + bias
    position += noise * np.random.default_rng(3).standard_normal(len(voltage))
    return Experiment("", PERIOD, voltage, position, (), 10.0, ())


def of_sides(u, g_low, g_high, low, high):
    return g_high * np.maximum(0.0, u - high) + g_low * np.minimum(0.0, u - low)


@pytest.mark.parametrize(
    ("sides", "dead"),
    [
        ((0.83, 0.97, -0.3, 0.3), True),
        ((0.83, 0.97, -0.1, 0.5), True),
        ((0.9, 0.9, 0.2, -0.2), False),  # underlap: both sides act around the null
        ((0.8, 1.0, 0.0, 0.0), False),
    ],
)
def test_the_table_is_the_curve_of_both_sides(sides, dead):
    """Beside the overlap it is exact; within it the table rises a little, so that its inverse is no step."""
    g_low, g_high, low, high = sides
    found = measured_sides(*sides)
    made = characteristic.parameters(found, 0.9, 10.0)
    u = np.linspace(-10.0, 10.0, 2001)
    table = np.interp(u, made["linearisation.voltage"], made["linearisation.position"])
    off = np.abs(table - of_sides(u, *sides))
    assert np.max(off[(u < low - 0.05) | (u > high + 0.05)]) < 1e-9
    assert np.max(off) < (0.02 if dead else 1e-9)
    assert made["linearisation.gain"] == 0.9
    slopes = np.diff(made["linearisation.position"]) / np.diff(made["linearisation.voltage"])
    assert np.min(slopes) == pytest.approx(0.05 * 0.9 if dead else min(g_low, g_high))


def measured_sides(g_low, g_high, low, high):
    """A curve that is known without a measurement."""
    at = np.linspace(-4.0, 4.0, characteristic.POINTS)
    curve = of_sides(at, g_low, g_high, low, high)

    def exact(value):
        return characteristic.Bounded(value, 0.0)

    up, down = (characteristic.Side(exact(g), exact(e)) for g, e in ((g_high, high), (g_low, low)))
    return characteristic.Characteristic(
        at, curve, curve, up, down, exact(high - low), exact(0.5 * (low + high)), exact(0.0), 4
    )


def close(found, value, least=0.004):
    """Whether ``value`` lies within twice the bound of ``found``, which is narrow."""
    return abs(found.value - value) < max(2.0 * found.bound, least) and found.bound < 0.02


@pytest.mark.parametrize(
    "valve",
    [
        {},
        {"low": -0.3, "high": 0.3},
        {"positive": 0.9, "negative": 0.78},
        {"play": 0.1},
        {"low": -0.2, "high": 0.5, "positive": 1.05, "negative": 0.8, "play": 0.15},
    ],
)
def test_the_static_curve_comes_back(valve):
    found = curve_of(static(**valve), -0.5 * PERIOD)
    given = {"positive": 0.9, "negative": 0.9, "low": 0.0, "high": 0.0, "play": 0.0, **valve}
    assert close(found.positive.gain, given["positive"]) and close(found.negative.gain, given["negative"])
    assert close(found.overlap, given["high"] - given["low"])
    assert close(found.null, 0.5 * (given["high"] + given["low"]))
    assert close(found.hysteresis, 2.0 * given["play"])
    assert found.lopsided == ("low" in valve or "negative" in valve)
    assert len(found.voltage) == characteristic.POINTS
    force = with_overlap(found.voltage - given["play"], given["low"], given["high"])
    rising = np.where(force > 0.0, given["positive"], given["negative"]) * force
    inner = np.abs(found.voltage) < 3.5
    assert found.rising[inner] == pytest.approx(rising[inner], abs=0.02)


@pytest.mark.parametrize(
    ("half", "coulomb", "presliding"),
    [(0.1, 0.0, 0.0), (0.3, 0.3, 0.03), (0.05, 1.0, 0.02)],
)
def test_the_turn_tells_play_from_friction(half, coulomb, presliding):
    """Play before model (3) with friction: the sum within 1 mV, the shares within 0.03 V."""
    valve = {"friction.coulomb": coulomb, "friction.presliding": max(presliding, 0.02), "lvdt.noise": 0.005}
    voltage = triangle()
    done = experiment.simulated(
        defaults(CONTROLLER),
        updated(VALVE, defaults(VALVE), valve),
        {**experiment.test_values(friction.TEST, PERIOD), "scenario": "array"},
        played(voltage, half),
    )._replace(voltage=voltage)
    found = curve_of(done, LAG)
    assert found.hysteresis.value == pytest.approx(2.0 * (half + coulomb), abs=0.002)
    assert found.shares.play == pytest.approx(half, abs=0.03)
    assert found.shares.friction == pytest.approx(coulomb, abs=0.03)
    if coulomb > 0.0:
        assert found.shares.presliding == pytest.approx(presliding, rel=0.12)


@pytest.mark.parametrize("period", [0.005, 0.00025])
def test_a_spool_that_swings_on_its_bristles_has_no_play(period):
    """Of friction with a Stribeck peak; a play of 0.11 V was told at 5 ms and one of 0.22 V at 0.25 ms."""
    test = experiment.test_values(friction.TEST, period)
    rubbing = {"friction.coulomb": 1.16, "friction.static_ratio": 1.25, "friction.presliding": 0.02}
    done = experiment.simulated(
        changed.controller(sample_period=period, reshaping__natural_frequency=50.0),
        updated(VALVE, defaults(VALVE), {**rubbing, "sample_period": period, "lvdt.noise": 0.0056}),
        test,
    )
    assert curve_of(done, LAG).shares is None


@pytest.mark.parametrize(("presliding", "told"), [(0.0, True), (0.02, False)])
def test_friction_without_presliding_is_not_taken_for_play_alone(presliding, told):
    """A linear valve without play whose spool swings at the turns: it stands still behind them too."""
    w = 2.0 * np.pi * 6.0
    valve = {"valve": "custom", "numerator": [0.9 * w * w], "denominator": [1.0, 0.2 * w, w * w]}
    rubbing = {"friction.coulomb": 0.3, "friction.presliding": presliding, "lvdt.noise": 0.003}
    done = experiment.simulated(
        defaults(CONTROLLER),
        updated(VALVE, defaults(VALVE), {**valve, **rubbing}),
        {**experiment.test_values(friction.TEST, PERIOD), "scenario": "array"},
        triangle(),
    )
    found = curve_of(done, 0.2 / w)
    assert found.hysteresis.value == pytest.approx(0.6, abs=0.01)
    said = characteristic.text(found)
    assert ("or friction without presliding, which looks the same" in said) == told
    assert (found.shares is not None and found.shares.play > 0.05) == told


def test_unequal_gains_and_overlap_hide_no_play(positive=1.05, overlap=0.3):
    """A turn of the voltage lies on one side alone, far from the middle; friction is a force."""
    valve = {
        "valve": "solenoid",
        "solenoid.gain": 0.9,
        "solenoid.hysteresis": 0.3,
        "solenoid.positive": positive,
        "solenoid.negative": 0.95,
        "solenoid.overlap": overlap,
        "friction.coulomb": 0.4,
        "friction.presliding": 0.02,
        "friction.static_ratio": 1.0,
        "lvdt.noise": 0.003,
    }
    values = updated(VALVE, defaults(VALVE), valve)
    done = experiment.simulated(defaults(CONTROLLER), values, experiment.test_values(friction.TEST, PERIOD))
    lag = friction.lag_of(build.valve_model(values), 0.0)
    found = curve_of(done, lag)
    assert found.lopsided
    assert found.shares.play == pytest.approx(0.15, abs=0.03)
    assert found.shares.friction == pytest.approx(0.4 / (0.5 * (positive + 0.95)), abs=0.03)
    assert found.shares.presliding == pytest.approx(0.02, rel=0.15)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.9])
def test_a_describing_function_is_the_first_harmonic_of_a_play(share):
    angle = np.linspace(0.0, 6.0 * np.pi, 60000, endpoint=False)
    behind = played(np.sin(angle), share)[-20000:]
    harmonic = 2.0 * np.mean(behind * np.exp(-1j * angle[-20000:])) / -1j
    assert friction.through_play(share) == pytest.approx(harmonic, abs=1e-4)


@pytest.mark.parametrize(
    ("valve", "coulomb", "null"),
    [
        ({"positive": 0.9, "negative": 0.77}, 0.0, 0.0),
        ({"low": -0.1, "high": 0.4, "play": 0.1}, 0.1, 0.15),
    ],
)
def test_overlap_and_unequal_gains_are_no_friction(valve, coulomb, null):
    """Before: an overlap of 0.6 V was a friction of 0.3 V, and gains 15 % apart an offset of 0.2 V."""
    one = static(**valve)
    found, curve = characteristic.friction_and_curve(one, 0.0)
    assert curve.lopsided
    assert found.coulomb == pytest.approx(coulomb, abs=0.01)
    assert found.offset == pytest.approx(-null, abs=0.01)


def test_an_even_valve_keeps_its_friction_and_one_side_has_no_curve():
    one = static(play=0.2)
    assert characteristic.friction_and_curve(one, 0.0)[0].coulomb == pytest.approx(0.2, abs=0.002)
    lifted = one._replace(position=one.position + 9.0)
    found, curve = characteristic.friction_and_curve(lifted, 0.0)
    assert curve is None and found.coulomb == pytest.approx(0.2, abs=0.01)
