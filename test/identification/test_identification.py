# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""From voltages and readings to models: what goes in must come out, and nothing is invented."""

import math

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.control.simulation import offline
from valve_control.design.identification import (
    bode,
    bode_fit,
    datasheet,
    experiment,
    lvdt,
    response,
    result,
    theta,
)
from valve_control.design.identification.response import Response, Segment
from valve_control.parameter import ParameterError, defaults, updated

COEFFICIENTS = np.array([*FOURTH_ORDER.numerator, *FOURTH_ORDER.denominator[1:]])
SHORT = {"steps": 20, "cycles": 4, "step_time": 0.8, "frequency": 0.8}


def measure(noise=0.0, seed=1, settle=0.4, period=0.001, valve=None, **command):
    plant = {"lvdt.noise": noise, "seed": seed, "sample_period": period, **(valve or {})}
    done = experiment.simulated(
        updated(CONTROLLER, defaults(CONTROLLER), {"sample_period": period}),
        updated(VALVE, defaults(VALVE), plant),
        experiment.test_values({"sample_period": period, **SHORT, **command}, period),
    )
    return experiment.estimate(done, settle, None)


def made(model=FOURTH_ORDER, deviation=1e-4, seed=1, count=30, highest=100.0, delay=0.0, period=0.001):
    """A response as a stepped sine of equal length would measure it."""
    f = np.geomspace(0.5, highest, count)
    noise = np.random.default_rng(seed).standard_normal((2, count)) * deviation
    value = bode.held_response(model, f, period, delay) + noise[0] + 1j * noise[1]
    spread = np.full(count, max(deviation, 1e-9))
    return Response(f, value, spread, np.ones(count), period, "stepped sine", ())


def test_fourth_order_comes_back_within_3_per_cent_at_5_mv_of_noise(period=0.0025):
    measured = measure(0.005, period=period)
    fit = bode_fit.fit(measured, 4)
    assert np.max(np.abs(fit.values / COEFFICIENTS - 1.0)) < 0.03
    true = bode.held_response(FOURTH_ORDER, measured.frequency, period)
    chi2 = np.mean(np.abs(true - measured.value) ** 2 / measured.deviation**2) / 2.0
    assert 0.4 < chi2 < 1.9
    assert np.allclose(fit.corners, bode.model_corners(FOURTH_ORDER), rtol=0.02)


def test_a_record_may_begin_and_end_in_motion():
    """Held random voltages, and a piece out of a sweep, neither from rest nor to rest."""
    random, t = np.random.default_rng(1), np.arange(45_000) * 0.001
    sweep = 2.0 * np.sin(2.0 * np.pi * 0.5 * 11.0 * np.expm1(t / 11.0))
    noise = np.clip(2.0 * np.repeat(random.standard_normal(5000), 4), -8.0, 8.0)
    test = {**experiment.test_values({"scenario": "sine"}, 0.001), "scenario": "array"}
    swept, shaken = (
        experiment.simulated(defaults(CONTROLLER), defaults(VALVE), test, motion) for motion in (sweep, noise)
    )
    fit = bode_fit.fit(experiment.estimate(shaken, 0.4, None), 4)
    assert np.max(np.abs(fit.values / COEFFICIENTS - 1.0)) < 1e-4
    cut = swept._replace(voltage=swept.voltage[2345:-4321], position=swept.position[2345:-4321])
    measured = experiment.estimate(cut, 0.4, None)
    assert measured.frequency[-1] < 25.0
    true = bode.held_response(FOURTH_ORDER, measured.frequency, 0.001)
    assert np.max(np.abs(measured.value / true - 1.0)) < 0.01


def test_bounds_cover_the_truth():
    hits = []
    for seed in range(25):
        fit = bode_fit.fit(made(seed=seed), 4)
        assert np.max(np.abs(fit.values / COEFFICIENTS - 1.0)) < 0.2
        hits.append(np.abs(fit.values - COEFFICIENTS) <= fit.bounds)
    assert 0.88 < np.mean(hits) < 1.0 and np.min(np.mean(hits, axis=0)) > 0.75


def test_second_order_fit_of_3_lands_on_2():
    """Over 1 to 40 Hz and in per cent, as on a Bode plot; the print of Fig. 1 ends near there."""
    f = np.geomspace(1.0, 40.0, 40)
    value = bode.held_response(FOURTH_ORDER, f, 0.001)
    measured = Response(f, value, 1e-6 * np.abs(value), np.ones(40), 0.001, "stepped sine", ())
    fit = bode_fit.fit(measured, 2)
    assert np.allclose(fit.values, [1502.057, 58.771, 1657.206], rtol=0.03)
    assert fit.model_error > 0.05


@pytest.mark.parametrize("order", [2, 3])
def test_an_exact_model_comes_back(order):
    model = SECOND_ORDER if order == 2 else TransferFunction((4e4, 3e6), (1.0, 120.0, 9000.0, 4e5))
    fit = bode_fit.fit(made(model, deviation=0.0), order)
    assert np.allclose(fit.model.numerator, model.numerator, rtol=1e-4)
    assert np.allclose(fit.model.denominator, model.denominator, rtol=1e-4)
    assert fit.model_error < 1e-4


@pytest.mark.parametrize("delay", [0.0007, 0.0121])
def test_dead_time_comes_back(delay):
    fit = bode_fit.fit(made(deviation=1e-5, delay=delay), 4, delayed=True)
    assert abs(fit.delay - delay) < 2e-5 and abs(fit.delay - delay) < 2.0 * fit.bounds[-1]
    assert np.allclose(fit.values[:-1], COEFFICIENTS, rtol=0.02)


def test_dead_time_of_the_simulated_valve_comes_back():
    """Readings between two samples must lie on the valve's own path, not on a straight line."""
    fit = bode_fit.fit(measure(valve={"lvdt.delay": 0.0007}), 4, delayed=True)
    assert abs(fit.delay - 0.0007) < 1e-7
    assert np.allclose(fit.values[:-1], COEFFICIENTS, rtol=1e-4)
    assert fit.names == ("b2", "b1", "b0", "a3", "a2", "a1", "a0", "delay")
    assert np.allclose(fit.corners, bode.model_corners(FOURTH_ORDER, 0.0007), rtol=1e-4)


@pytest.mark.parametrize(
    "valve",
    [
        {"valve": "custom", "numerator": [1.0], "denominator": [1.0, -5.0, 100.0]},
        {"flow_force": -1.207},
        {"drift.stiffness": -0.2},
    ],
)
def test_unstable_valve_is_not_tested(valve):
    with pytest.raises(ParameterError, match="the valve is unstable"):
        measure(valve=valve)


def test_segments_are_found_in_a_voltage_alone():
    t = np.arange(3000) * 0.001
    parts = [np.sin(2.0 * np.pi * f * t[: round(8000 / f)]) for f in (4.0, 5.0, 20.0, 90.0)]
    voltage = 0.3 + 2.0 * np.concatenate([np.zeros(100), *parts, np.zeros(50)])
    found = response.find_segments(voltage, 0.001)
    assert np.allclose([s.frequency for s in found], [4.0, 5.0, 20.0, 90.0], rtol=1e-3)


def test_no_segments_in_a_sweep():
    t = np.arange(20_000) * 0.001
    sweep = np.sin(2.0 * np.pi * (0.5 * t + 2.0 * t**2))
    assert response.find_segments(sweep, 0.001) == []


def test_transient_and_noise_are_refused():
    u = np.sin(np.arange(1000) * 0.1)
    with pytest.raises(ParameterError, match="1 whole cycles after its transient"):
        response.stepped(u, u, [Segment(0, 200, 10.0)], 0.001, 0.1)
    noise = np.random.default_rng(1).standard_normal(1000)
    with pytest.raises(ParameterError, match="lost in noise"):
        response.stepped(u, noise, [Segment(0, 1000, 100.0 / (2.0 * np.pi))], 0.001, 0.1)


def test_suggested_theta_holds_every_second_order_model_of_the_valve():
    measured = made()
    second, fourth = bode_fit.fit(measured, 2), bode_fit.fit(measured, 4)
    found = theta.suggest(measured, second, fourth, 10.0)
    assert np.allclose(found.initial[:3], second.values[[1, 2, 0]], rtol=1e-4) and found.initial[3] == 0.0
    for model in ([58.771, 1657.206, 1502.057], [48.0, 1515.0, 1260.0]):
        assert np.all(np.array(found.lower[:3]) < model) and np.all(model < np.array(found.upper[:3]))
    assert found.lower[2] > 0.0 and found.lower[3] == -found.upper[3]


def test_coherence_is_the_share_of_the_motion_that_is_the_voltages():
    """Of a sine with amplitude |Y| in noise σ: (|Y|²/2) / (|Y|²/2 + σ²), at each frequency.

    |Y| is known to its own deviation.
    """
    noise, amplitude = 0.05, 2.0
    measured = measure(noise, amplitude=amplitude)
    size = amplitude * np.abs(bode.held_response(FOURTH_ORDER, measured.frequency, 0.001))
    for side in (-1.0, 1.0):
        power = 0.5 * np.maximum(0.0, size + side * 4.0 * amplitude * measured.deviation) ** 2
        rest = measured.coherence - power / (power + noise**2)
        assert np.all(-side * rest > -0.002), rest
    assert measured.coherence[0] > 0.99


def log(law, noise, valve, **command):
    """A table of a simulated run under ``law``, whose gains are those of the valve's data sheet."""
    tree = result.parameters(datasheet.valve({**valve, "lvdt.noise": noise}))
    test = {"frequency": 0.5, "end_frequency": 30.0, "sweep_time": 20.0, "amplitude": 1.0, **command}
    motion = build.commands(experiment.test_values({"scenario": "sweep", **test}, 0.001))
    run = offline.simulate(
        updated(CONTROLLER, defaults(CONTROLLER), {"controller": law, **tree["controller"]}),
        updated(VALVE, defaults(VALVE), {"seed": 3, **tree["valve_simulator"]}),
        motion,
    )
    return experiment.Experiment("log", 0.001, run.voltage, run.measurement, (), 10.0, (), command=motion)


@pytest.mark.parametrize("law", ["pid", "dcarc"])
@pytest.mark.parametrize(
    ("hertz", "damping", "stroke", "noise"),
    [(9.0, 0.7, 9.0, 0.01), (14.0, 1.0, 8.0, 0.02), (6.0, 0.5, 11.0, 0.005)],
)
def test_under_feedback_the_command_is_the_instrument(law, hertz, damping, stroke, noise):
    """Before: spectra of voltage and position alone, and bounds that the truth missed."""
    valve = {"natural_frequency": hertz, "damping": damping, "full_stroke": stroke}
    table = log(law, noise, valve)
    assert "depends on the reading" in experiment.excited(table).feedback
    fit = bode_fit.fit(experiment.estimate(experiment.excited(table), 0.4, None), 2)
    model = datasheet.valve(valve).known.model
    true = np.array([*model.numerator, *model.denominator[1:]])
    assert np.all(np.abs(fit.values - true) < 1.5 * fit.bounds) and np.all(fit.bounds < 0.05 * true)
    assert fit.corners == pytest.approx(bode.model_corners(model), rel=0.03)
    with pytest.raises(ParameterError, match="under feedback .* has no command that moves"):
        experiment.excited(table._replace(command=np.full(len(table.voltage), np.nan)))


@pytest.mark.parametrize(
    ("noise", "command"),
    [
        (0.005, {}),
        (0.0, {}),
        (0.005, {"scenario": "stepped_sine"}),
        (0.02, {"scenario": "triangle"}),
    ],
)
def test_no_feedback_is_invented(noise, command):
    assert experiment.excited(log("open_loop", noise, {"natural_frequency": 9.0}, **command)).feedback == ""


@pytest.mark.parametrize(("first", "end"), [(9_000, 11_000), (20_000, 26_000), (25_000, 25_500)])
@pytest.mark.parametrize("numbered", [True, False])
def test_all_whole_stretches_of_a_test_count(first, end, numbered):
    """Readings are missing, or time leaps; before, they were drawn as a line, or one stretch counted."""
    whole = log("open_loop", 0.005, {"natural_frequency": 9.0}, sweep_time=30.0)
    rows = [whole.voltage.copy(), whole.position.copy(), whole.command.copy()]
    for row in rows:
        row[first:end] = np.nan
    if not numbered:
        rows = [np.delete(row, np.arange(first, end)) for row in rows]
    voltage, position, command = rows
    leaps = () if numbered else (first,)
    table = whole._replace(voltage=voltage, position=position, command=command, leaps=leaps)
    measured = experiment.estimate(experiment.excited(table), 0.4, None)
    assert measured.frequency[0] < 1.0 and measured.frequency[-1] > 25.0
    fit = bode_fit.fit(measured, 2)
    a0, bound = float(fit.values[-1]), float(fit.bounds[-1])
    assert abs(a0 - (2.0 * math.pi * 9.0) ** 2) < 1.5 * bound < 0.02 * a0
    assert abs(fit.corners.minus_90 - 9.0) < 0.1


def test_what_the_test_did_not_excite_is_not_claimed():
    """A test up to 3 Hz of a valve whose -90° lies at 6.4 Hz and its second pair of poles at 32 Hz."""
    low, whole = made(highest=3.0), made()
    second = bode_fit.fit(low, 2)
    assert result.fit_dict(second, low)["minus_90_hz"] is None
    told = result.fit_text(second, low)
    assert "-90° at none" in told and "(not excited by the test)" in told
    fourth = bode_fit.fit(whole, 4)
    assert result.fit_dict(fourth, whole)["minus_90_hz"] == pytest.approx(6.17, rel=0.01)
    assert "not excited" not in result.fit_text(fourth, whole)


def test_a_recording_may_begin_without_a_voltage():
    """Its first answer was lost; "the voltage does not move" was said of any motion."""
    voltage = np.random.default_rng(2).standard_normal(20000)
    position = scipy.signal.lfilter([0.0, 0.1], [1.0, -0.9], voltage)
    whole = experiment.Experiment("a bag", 0.001, voltage, position, (), 10.0, ())
    late = whole._replace(voltage=np.concatenate([np.full(3, np.nan), voltage[3:]]))
    found = experiment.estimate(late, 0.4, (1.0, 50.0))
    cut = whole._replace(voltage=voltage[3:], position=position[3:])
    wanted = experiment.estimate(cut, 0.4, (1.0, 50.0))
    assert np.array_equal(found.value, wanted.value)
    true = scipy.signal.freqz([0.0, 0.1], [1.0, -0.9], found.frequency, fs=1000.0)[1]
    assert found.value == pytest.approx(true, rel=0.01)


def with_coil(hertz, damping, lag, gain=0.85):
    omega = 2.0 * math.pi * hertz
    denominator = np.polymul([1.0, 2.0 * damping * omega, omega**2], [1.0, 1.0 / lag])
    return TransferFunction((gain * omega**2 / lag,), tuple(map(float, denominator)))


@pytest.mark.parametrize("delay", [0.0, 0.0005, 0.001])
@pytest.mark.parametrize(("hertz", "damping", "lag"), [(9.0, 0.8, 0.004), (7.0, 0.8, 0.003)])
def test_a_coil_is_a_pole_and_not_dead_time(hertz, damping, lag, delay):
    best = bode_fit.choose(made(with_coil(hertz, damping, lag), delay=delay))
    assert (best.order, len(best.model.numerator)) == (3, 1)
    assert ("delay" in best.names) == (delay > 0.0)
    assert abs(best.delay - delay) < 1e-5
    fast = max(bode.roots(best.model.denominator), key=lambda root: root.frequency)
    assert 2.0 * math.pi * fast.frequency * lag == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("model", "delay", "form"),
    [
        (SECOND_ORDER, 0.0, (2, 0, False)),
        (SECOND_ORDER, 0.001, (2, 0, True)),
        (FOURTH_ORDER, 0.0, (4, 2, False)),
        (FOURTH_ORDER, 0.006, (4, 2, True)),
    ],
)
def test_the_models_of_the_paper_keep_their_structure(model, delay, form):
    best = bode_fit.choose(made(model, delay=delay))
    assert (best.order, len(best.model.numerator) - 1, "delay" in best.names) == form
    assert np.allclose(best.values[: len(best.values) - form[2]][-1], model.denominator[-1], rtol=0.02)


def test_noise_that_explains_the_second_order_ends_the_search():
    measured = made(SECOND_ORDER, deviation=1e-3)
    assert bode_fit.choose(measured).names == ("b0", "a1", "a0")


@settings(max_examples=40, deadline=None)
@given(
    noise=st.floats(1e-3, 15e-3),
    resolution=st.sampled_from([0.0, 0.5e-3, 3.7e-3]),
    frequency=st.floats(0.1, 20.0),
    seed=st.integers(0, 1000),
)
def test_noise_and_step_come_back_under_a_motion(noise, resolution, frequency, seed):
    random = np.random.default_rng(seed)
    t = np.arange(20_000) * 0.001
    y = 2.0 * np.sin(2.0 * np.pi * frequency * t) + noise * random.standard_normal(len(t))
    y = resolution * np.round(y / resolution) if resolution else y
    found = lvdt.observe(y)
    assert found.resolution == pytest.approx(resolution, rel=1e-6)
    # In the sum with the steps' variance the estimate is good to 3 %.
    assert np.hypot(found.noise, resolution / 12**0.5) == pytest.approx(
        np.hypot(noise, resolution / 12**0.5), rel=0.06
    )


def test_lost_readings_do_not_count_and_too_few_tell_nothing():
    random = np.random.default_rng(1)
    y = 0.005 * random.standard_normal(5000)
    y[::50] = np.nan
    assert lvdt.observe(y).noise == pytest.approx(0.005, rel=0.06)
    assert lvdt.observe(y[:20]) == (0.0, 0.0)


def test_noise_below_a_step_is_hidden():
    found = lvdt.observe(0.01 * np.round(np.linspace(0.0, 1.0, 5000) / 0.01))
    assert found.resolution == pytest.approx(0.01) and found.noise == 0.0
