# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from changed import controller
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.analysis.indices import rms
from valve_control.control.commands import arrays, scenarios
from valve_control.control.laws import command_lead, registry, reshaping
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import VALVE
from valve_control.control.simulation import offline
from valve_control.parameter import defaults, updated

PERIOD = 0.001
LAG = 2.0 * 0.8 / 314.0  # s, of (8)
TIME = np.arange(2000) * PERIOD
FADE_IN = np.clip(TIME / 0.3, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(TIME / 0.3, 0.0, 1.0))
SINES = FADE_IN * sum(a * np.sin(2.0 * math.pi * f * TIME) for f, a in ((3.0, 1.0), (9.0, 0.3), (15.0, 0.1)))
FAST = arrays.sampled(
    scenarios.Shape("point_to_point", 1.5, 0.0, 0.1, 1.0, 1.0, 40.0, 2000.0, 0.4, 1.0), PERIOD, len(TIME)
)
D3FXE = files.load(str(files.config_folder() / "d3fxe.yaml"))["valve_simulator"]


def led(commands, **changes):
    return command_lead.applied(
        command_lead.build(controller(**changes), True), np.array(commands, dtype=float)
    )


def reference(commands, values=None):
    """x_vd under these commands."""
    p = reshaping.build(values or controller())
    s = reshaping.State(float(commands[0]), 0.0)
    got = []
    for command in commands:
        got.append(s.reference)
        s = reshaping.advance(p, s, reshaping.acceleration(p, s, float(command)))
    return np.array(got)


def test_without_lead_there_is_nothing_to_compute():
    assert command_lead.build(controller(), True) is None
    assert command_lead.applied(None, SINES) is SINES


def test_a_ramp_is_followed_without_lag():
    ramp = 8.0 * TIME[:500]
    assert ramp[-1] - reference(ramp)[-1] == pytest.approx(8.0 * LAG, rel=1e-6)
    assert ramp[-1] - reference(led(ramp, reshaping__lead=LAG))[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("frequency", [3.0, 9.0, 15.0])
def test_a_sine_has_the_error_of_the_equation(frequency):
    """With T = 2·ξ/ω_n, x_vd/x_vLd - 1 = -(s/ω_n)²/(1 + T·s + (s/ω_n)²): second order instead of first."""
    sine = 0.3 * np.sin(2.0 * math.pi * frequency * TIME)
    s = 2j * math.pi * frequency
    expected = abs((s / 314.0) ** 2 / (1.0 + LAG * s + (s / 314.0) ** 2))
    cycles = slice(1000, 2000)  # whole ones
    error = rms((reference(led(sine, reshaping__lead=LAG)) - sine)[cycles]) / rms(sine[cycles])
    # The median takes the rate 1.5 periods ago, (11) is an Euler step: both are of the same second order.
    assert error == pytest.approx(expected, abs=2.5 * LAG * PERIOD * abs(s) ** 2)
    assert error < 0.4 * rms((reference(sine) - sine)[cycles]) / rms(sine[cycles])


PARABOLA = 200.0 * TIME[:180] ** 2  # V  below all limits


@pytest.mark.parametrize(
    "natural_frequency, damping", [(314.0, 0.8), (800.0, 0.8), (1000.0, 1.0), (500.0, 1.27)]
)
@pytest.mark.parametrize("ahead", [0.0, 0.002, 0.005])
def test_with_the_acceleration_a_parabola_is_followed_without_error(natural_frequency, damping, ahead):
    """The reference is the command that comes ``ahead``, which makes up for a loop that is later by that."""
    changes = {"reshaping__natural_frequency": natural_frequency, "reshaping__damping": damping}
    lead = 2.0 * damping / natural_frequency + ahead
    wanted = 200.0 * (TIME[120:180] + ahead) ** 2
    for share, left in ((1.0, 0.0), (0.0, None)):
        given = led(PARABOLA, reshaping__lead=lead, reshaping__lead_accel=share, **changes)
        error = reference(given, controller(**changes))[120:180] - wanted
        if left is None:
            bend = command_lead.build(
                controller(reshaping__lead=lead, reshaping__lead_accel=1.0, **changes), True
            )
            left = -400.0 * (bend.bend + 0.0015 * lead)
        assert error == pytest.approx(left, abs=1e-9)


@pytest.mark.parametrize("lead", [0.002, 0.01])
def test_a_law_that_does_not_reshape_gets_the_parabola_ahead(lead):
    p = command_lead.build(controller(reshaping__lead=lead, reshaping__lead_accel=1.0), False)
    ahead = 200.0 * (TIME[:180] + lead) ** 2
    assert command_lead.applied(p, PARABOLA)[10:100] == pytest.approx(ahead[10:100], abs=1e-9)


def test_with_the_acceleration_a_sine_has_an_error_of_third_order():
    """Half the frequency: an eighth of the error, not a quarter."""
    errors = []
    for frequency in (2.0, 4.0, 8.0):
        sine = np.sin(2.0 * math.pi * frequency * TIME)
        made = reference(led(sine, reshaping__lead=LAG, reshaping__lead_accel=1.0))
        errors.append(rms((made - sine)[1000:2000]))
    assert errors[1] / errors[0] == pytest.approx(8.0, rel=0.1)
    assert errors[2] / errors[1] == pytest.approx(8.0, rel=0.1)


@given(
    st.floats(-10.0, 10.0),
    st.floats(-10.0, 10.0),
    st.floats(0.001, 0.1),
    st.integers(1, 30),
    st.integers(0, 9),
    st.floats(0.0, 1.0),
)
def test_a_step_is_no_motion(before, after, lead, wait, late, share):
    """So it overshoots not at all, whatever its height."""
    command = [before] * wait + [after] * (20 + late)
    assert np.array_equal(led(command, reshaping__lead=lead, reshaping__lead_accel=share), command)


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=200), st.floats(0.001, 0.1), st.floats(0.0, 1.0))
def test_whatever_comes_the_lead_stays_within_the_limits(commands, lead, share):
    p = command_lead.build(controller(reshaping__lead=lead, reshaping__lead_accel=share), True)
    s = command_lead.initial(commands[0])
    for command in commands:
        before, s = s.rate, command_lead.step(p, s, command)
        assert abs(s.rate) <= 250.0  # (7)
        assert abs(s.rate) <= abs(before) + 12.0 * (1.0 + 1e-9)  # (6)
        assert abs(s.accel) <= 12000.0 * (1.0 + 1e-9)  # (6)
        assert abs(command_lead.led(p, s, command)) <= 10.0


def test_a_command_that_comes_late_and_then_twice_keeps_its_lead():
    ramp = 50.0 * TIME[:100]
    jittery = ramp.copy()
    jittery[60] = ramp[59]  # one came too late for its sample
    assert np.allclose(led(jittery, reshaping__lead=LAG) - jittery, led(ramp, reshaping__lead=LAG) - ramp)


# The lead of each law on this valve: 2·ξ_n/ω_n, and the lag of its loop where that is large.
LEADS = {
    "arc": LAG,
    "oarc": 0.0042,
    "pid": 0.020,
    "dcarc": LAG,
    "compensator": 0.036,
    "open_loop": 0.060,
}


def run(law, command, lead, **changes):
    values = controller(controller=law, reshaping__lead=lead, arc__velocity_cutoff=100.0, **changes)
    plant = updated(VALVE, defaults(VALVE), D3FXE)
    made = offline.simulate(values, plant, command)
    moving = slice(300, None)
    steps = np.diff(made.voltage[moving])
    return rms((made.position - command)[moving]), rms(steps) / rms(made.voltage[moving])


@pytest.mark.parametrize("law", LEADS)
@pytest.mark.parametrize("command", [SINES, FAST], ids=["sines of 3, 9 and 15 Hz", "fast point to point"])
def test_the_error_falls_to_0_6_at_the_same_chatter(law, command):
    assert set(registry.LAWS) >= set(LEADS)
    without, chatter = run(law, command, 0.0)
    error, chatter_with_lead = run(law, command, LEADS[law])
    assert error < 0.6 * without
    assert chatter_with_lead < 1.05 * chatter + 0.04


@pytest.mark.parametrize("command", [SINES, FAST], ids=["sines of 3, 9 and 15 Hz", "fast point to point"])
def test_a_lead_of_3_ms_halves_the_error_of_the_tuned_plain_pid(command):
    tuned = files.load(str(files.config_folder() / "tuned" / "narrow_0.25_pid_plain.yaml"))["controller"]
    gains = {name.replace(".", "__"): value for name, value in tuned.items() if name != "controller"}
    without, chatter = run("pid", command, 0.0, **gains)
    error, chatter_with_lead = run("pid", command, 0.003, **gains)
    assert error < 0.6 * without
    assert chatter_with_lead < 1.05 * chatter


def overshoot(position, height):
    return float(np.max(position)) / height - 1.0


@pytest.mark.parametrize("law", ["arc", "oarc", "pid"])
@pytest.mark.parametrize("height", [0.2, 0.5, 2.0])
def test_a_step_of_the_spool_overshoots_no_more_than_without_lead(law, height):
    command = np.where(TIME[:600] < 0.1, 0.0, height)
    plant = defaults(VALVE)
    runs = [
        offline.simulate(controller(controller=law, reshaping__lead=lead), plant, command)
        for lead in (0.0, LEADS[law])
    ]
    assert np.array_equal(runs[0].position, runs[1].position)
    assert overshoot(runs[1].position, height) <= overshoot(runs[0].position, height)


def test_the_lead_is_built_of_checked_values():
    p = command_lead.build(controller(reshaping__lead=0.006, reshaping__max_accel=9000.0), True)
    assert p == command_lead.Params(0.006, 0.0, 0.0, 250.0, 9.0, 10.0, 0.001)
    assert build.law_params(controller(reshaping__lead=0.006)) == build.law_params(controller())


def response(amplitude, frequency, **changes):
    """Spool over bare command on model (3) under dcarc at one frequency [Hz]."""
    t = np.arange(1600) * PERIOD
    command = amplitude * np.clip(t / 0.2, 0.0, 1.0) * np.sin(2.0 * math.pi * frequency * t)
    run = offline.simulate(controller(controller="dcarc", **changes), defaults(VALVE), command)
    cycles = slice(1600 - round(round(0.6 * frequency) / frequency / PERIOD), 1600)
    return complex(
        2.0j * np.mean(run.position[cycles] * np.exp(-2j * math.pi * frequency * t[cycles])) / amplitude
    )


def test_the_shipped_lead_has_no_peak_and_reaches_60_hz():
    """0.1 V: -90° beyond 60 Hz, at most +1 dB; 1 V: within 1 dB and 45° up to 18 Hz."""
    tuned = files.load(str(files.config_folder() / "tuned" / "reshaping_lead.yaml"))["controller"]
    changes = {name.replace(".", "__"): value for name, value in tuned.items()}
    small = [response(0.1, f, **changes) for f in (10.0, 20.0, 30.0, 40.0, 50.0, 55.0, 60.0)]
    assert max(map(abs, small)) < 10.0**0.05
    assert np.all(np.angle(small) > -0.5 * math.pi) and np.all(np.angle(small) < 0.0)
    large = [response(1.0, f, **changes) for f in (5.0, 10.0, 14.0, 16.0, 18.0)]
    assert np.all(np.abs(20.0 * np.log10(np.abs(large))) < 1.0)
    assert np.all(np.abs(np.angle(large, deg=True)) < 45.0)
    whole = [response(0.1, f, reshaping__lead=LAG) for f in (40.0, 50.0)]
    assert max(map(abs, whole)) > 10.0**0.15  # a lead for all of the lag peaks


def euler(natural_frequency, damping, frequency):
    """Command to reference, as (8), (11) and the lead have them in samples, below all limits."""
    z = np.exp(2j * math.pi * frequency * PERIOD)
    d = (z - 1.0) / PERIOD
    return natural_frequency**2 / (d * d + 2.0 * damping * natural_frequency * d + natural_frequency**2)


@pytest.mark.parametrize("amplitude", [0.02, 0.1])
def test_limit_6_is_where_a_sine_loses_its_form(amplitude):
    """Below max_accel/(2·π·f)² the reference is that of the linear filter; a little above it is not."""
    limit = math.sqrt(12000.0 / amplitude) / (2.0 * math.pi)
    for share, linear in ((0.8, True), (1.25, False)):
        f = share * limit
        wave = amplitude * np.sin(2.0 * math.pi * f * TIME)
        values = controller(reshaping__natural_frequency=700.0, reshaping__damping=0.8)
        made = reference(wave, values)[1000:]
        t = TIME[1000:]
        expected = np.imag(amplitude * euler(700.0, 0.8, f) * np.exp(2j * math.pi * f * t))
        assert (rms(made - expected) < 0.02 * rms(expected)) is linear
