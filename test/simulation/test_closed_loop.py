# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The promises: bandwidth, no chatter, equal bits, cost."""

import math

import numpy as np
import pytest

from valve_control.control.laws import registry
from valve_control.control.linear import stability
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND, NODES
from valve_control.control.simulation import offline
from valve_control.parameter import ParameterError, defaults, updated

LAWS = tuple(registry.LAWS)
REAL = {
    "lvdt.noise": 0.005,
    "lvdt.resolution": 0.003,
    "lvdt.delay": 0.0015,
    "friction.coulomb": 0.7,
    "friction.static_ratio": 1.3,
    "flow_force": 0.1,
    "drift.gain": 0.02,
}


def test_a_reference_that_is_cut_although_the_valve_could_follow_is_said(simulate):
    """A valve of 100 Hz with the limits of the D3FXE; with (6) and (7) of its own nothing is said."""
    valve = {"valve": "custom", "numerator": [394784.0], "denominator": [1.0, 1005.3, 394784.0]}
    command = np.where(np.arange(400) % 100 < 50, 0.0, 1.0)
    run = simulate("pid", command, valve=valve)
    assert "reshaping.max_accel 12000 cuts the reference in" in run.warning
    assert "3.948e+06" in run.warning
    own = {"reshaping.max_accel": 3.948e6, "reshaping.max_rate": 3927.0}
    assert "cuts the reference" not in simulate("pid", command, valve=valve, **own).warning


def trajectory(period=0.001):
    return build.commands(updated(COMMAND, defaults(COMMAND), {"sample_period": period}))


def response(simulate, controller, frequency, amplitude, **changes):
    """(gain [dB], phase [°]) of the true position against the command at one frequency [Hz]."""
    duration = math.ceil(max(2.0, 20.0 / frequency) * frequency) / frequency
    t = np.arange(round(duration / 0.001)) * 0.001
    run = simulate(controller, amplitude * np.sin(2.0 * math.pi * frequency * t), **changes)
    half = t >= duration / 2.0
    carrier = np.exp(-2j * math.pi * frequency * t[half])
    h = (run.position[half] @ carrier) / (run.command[half] @ carrier)
    return 20.0 * math.log10(abs(h)), math.degrees(np.angle(h))


@pytest.mark.parametrize(
    ("controller", "changes"),
    [(law, {}) for law in LAWS]
    + [
        ("arc", {"arc__robust_term": "quadratic"}),
        ("oarc", {"oarc__robust_term": "quadratic", "oarc__epsilon1": 5e4, "oarc__epsilon2": 5e4}),
        ("pid", {"pid__form": "reference"}),
        ("pid", {"pid__form": "plain"}),
        ("compensator", {"compensator__design": "designed"}),
    ],
)
def test_python_and_compiled_steps_give_the_same_bits(simulate, controller, changes):
    command = trajectory()[:1500] + np.random.default_rng(2).normal(size=1500)
    compiled = simulate(controller, command, valve=REAL, **changes)
    plain = simulate(controller, command, compiled=False, valve=REAL, **changes)
    assert np.array_equal(compiled.voltage, plain.voltage)
    assert np.array_equal(compiled.position, plain.position)
    for label, values in compiled.terms.items():
        assert np.array_equal(values, plain.terms[label]), label
    assert np.ptp(compiled.voltage) > 0.1


@pytest.mark.parametrize("frequency", [20.0, 30.0, 40.0, 42.0])
def test_arc_small_signal_beyond_40_hz(simulate, frequency):
    gain, phase = response(simulate, "arc", frequency, 0.1)
    assert gain > -3.0 and -90.0 < phase <= 0.0


@pytest.mark.parametrize("frequency", [5.0, 10.0, 20.0, 20.3])
def test_oarc_small_signal_gain_beyond_20_hz(simulate, frequency):
    gain, phase = response(simulate, "oarc", frequency, 0.1)
    assert gain > -3.0 and -90.0 < phase <= 0.0


@pytest.mark.parametrize("frequency", [30.0, 40.0, 42.0])
def test_oarc_phase_beyond_40_hz_and_gain_with_higher_gains(simulate, frequency):
    assert -90.0 < response(simulate, "oarc", frequency, 0.1)[1] <= 0.0
    gain, phase = response(simulate, "oarc", frequency, 0.1, oarc__ks1=200.0, oarc__ks2=200.0)
    assert gain > -3.0 and -90.0 < phase <= 0.0


def test_valve_alone_is_at_minus_90_degrees_at_6_2_hz(simulate):
    assert response(simulate, "open_loop", 6.1, 0.1)[1] > -92.0
    assert response(simulate, "open_loop", 6.5, 0.1)[1] < -90.0


@pytest.mark.parametrize("controller", ["arc", "oarc"])
@pytest.mark.parametrize("frequency", [5.0, 10.0, 15.0])
def test_one_volt_up_to_15_hz(simulate, controller, frequency):
    gain, phase = response(simulate, controller, frequency, 1.0)
    assert abs(gain) < 1.0 and abs(phase) < 45.0


def test_oarc_does_not_chatter_and_is_as_good_as_arc(simulate):
    arc = simulate("arc", trajectory())
    oarc = simulate("oarc", trajectory())
    assert oarc.indices.c_u < 0.05
    assert oarc.true_error["e_rms"] < 1.2 * arc.true_error["e_rms"]
    fine = trajectory(0.00025)
    arc = simulate("arc", fine, 0.00025)
    paper = simulate("oarc", fine, 0.00025, oarc__z2_weight=1.0)
    assert paper.indices.c_u < 0.05
    assert paper.true_error["e_rms"] < 1.2 * arc.true_error["e_rms"]
    assert paper.warning == ""


@pytest.mark.parametrize(
    ("period", "weight", "sound"),
    [
        (0.00025, 1.0, True),
        (0.0005, 1.0, False),
        (0.001, 1.0, False),
        (0.001, 3.0, False),
        (0.001, 10.0, True),
        (0.002, 10.0, True),
        (0.003, 10.0, False),
        (0.001, 1.44e6, True),
        (0.002, 1.44e6, True),
    ],
)
def test_warning_comes_exactly_when_the_loop_chatters(simulate, period, weight, sound):
    run = simulate("oarc", trajectory(period), period, oarc__z2_weight=weight)
    assert (run.indices.c_u < 0.05) == sound
    assert (run.warning == "") == sound
    if not sound:
        assert "oarc.z2_weight" in run.warning


def test_spectral_radius_of_a_loop_with_known_poles():
    """Plain proportional control of s² + a1·s + a0 against the closed form of the sampled loop."""
    from valve_control.control.laws import pid
    from valve_control.control.parameters.table import CONTROLLER

    values = updated(
        CONTROLLER,
        defaults(CONTROLLER),
        {
            "pid.form": "plain",
            "pid.kp": 2.0,
            "pid.ki": 0.0,
            "pid.kd": 0.0,
            "pid.static_feedforward": 0.0,
        },
    )
    import scipy.signal

    p = pid.build(values)
    a, b, c, _, _ = scipy.signal.cont2discrete(
        (
            np.array([[0.0, 1.0], [-1657.0, -58.0]]),
            np.array([[0.0], [1500.0]]),
            np.eye(1, 2),
            np.zeros((1, 1)),
        ),
        p.period,
    )
    expected = max(np.abs(np.linalg.eigvals(a - 2.0 * b @ c)))
    assert expected < 1.0
    # the integrator of gain 0, a pole at 1 of its own, does not reach the voltage and is no part of the loop
    assert stability.spectral_radius(pid.LAW, p, (58.0, 1657.0, 1500.0)) == pytest.approx(expected, rel=1e-6)
    values["pid.kp"] = 2e3
    p = pid.build(values)
    expected = max(np.abs(np.linalg.eigvals(a - 2e3 * b @ c)))
    assert stability.spectral_radius(pid.LAW, p, (58.0, 1657.0, 1500.0)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("controller", LAWS)
@pytest.mark.parametrize("seed", range(3))
def test_voltage_is_finite_and_within_the_limit(simulate, controller, seed):
    command = np.random.default_rng(seed).uniform(-10.0, 10.0, 2000)
    run = simulate(controller, command, valve={**REAL, "lvdt.bias": 5.0, "gain_scale": 3.0})
    assert np.all(np.isfinite(run.voltage)) and np.max(np.abs(run.voltage)) <= 10.0


def test_noise_that_would_begin_before_the_first_reading_is_refused():
    """The compiled loop reads as many numbers as there are commands."""
    values = [defaults(NODES[node]) for node in ("controller", "valve_simulator")]
    with pytest.raises(ParameterError, match="noise_start is -1"):
        offline.simulate(*values, np.zeros(10), noise_start=-1)


@pytest.mark.parametrize("controller", LAWS)
def test_a_run_in_pieces_has_the_bits_of_one(simulate, monkeypatch, controller):
    command = trajectory()[:2500]
    whole = simulate(controller, command, valve=REAL)
    monkeypatch.setattr(offline, "PIECE", 700)
    pieces = simulate(controller, command, valve=REAL)
    for name in ("position", "measurement", "voltage"):
        assert np.array_equal(getattr(whole, name), getattr(pieces, name))
    assert all(np.array_equal(whole.terms[name], pieces.terms[name]) for name in whole.terms)
    assert whole.theta == pieces.theta
