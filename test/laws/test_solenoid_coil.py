# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Solenoid valves: terms of the magnet in dcarc, and its hum."""

import math

import numpy as np
import pytest
import scipy.signal
from changed import controller, valve

from research import coil
from valve_control.control.laws import dcarc, dcarc_design
from valve_control.control.laws.signals import Start
from valve_control.control.linear import stability
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import transfer_functions
from valve_control.control.simulation import delivery
from valve_control.parameter import updated


def known(name, law, **changes):
    values = coil.controller(coil.VALVES[name], coil.TERMS)
    return updated(CONTROLLER, values, {"controller": law, **changes})


PERIOD = 0.001
NOTCH = [(name, hum) for name in coil.VALVES for hum in (50.0, 60.0)]


@pytest.mark.parametrize(("name", "hum"), NOTCH)
def test_what_is_known_of_the_hum_decays_at_the_width(name, hum):
    """The pole of the whole observer at the hum, against the walk that the derivation gives for its width."""
    values, turn = known(name, "dcarc"), 2.0 * math.pi * hum * PERIOD
    model = transfer_functions.chosen(values, "dcarc.model", "dcarc.")
    noises = (math.hypot(0.004, 0.0049 / math.sqrt(12.0)), 0.5, 4.0 * math.sqrt(PERIOD))
    plain = dcarc_design.observed(model, PERIOD, 0.0, *noises, coil.VALVES[name].coil)
    scale = np.append(dcarc_design.scale_of(model), 1.0)
    o = dcarc_design.humming(plain, dcarc_design.kalman(plain, scale), turn, PERIOD)
    gain = dcarc_design.kalman(o, np.append(scale, [1.0, 1.0]))
    poles = np.linalg.eigvals(o.a @ (np.eye(len(gain)) - np.outer(gain, o.c)))
    pole = poles[np.argmin(np.abs(poles - np.exp(1j * turn)))]
    assert -math.log(abs(pole)) / PERIOD == pytest.approx(2.0 * math.pi * dcarc_design.HUM_WIDTH, rel=0.02)
    assert np.angle(pole) == pytest.approx(turn, rel=0.002)


@pytest.mark.parametrize(("name", "hum"), NOTCH)
def test_a_hum_alone_leaves_the_voltage(name, hum):
    """By and by: the law without a valve has poles of its own that are slower than those of the loop."""

    def swing(notch):
        p = dcarc.build(known(name, "dcarc", **{"dcarc.hum": notch}))
        state, voltages = dcarc.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0)), []
        for k in range(8000):
            voltage, state, _ = dcarc.step(
                p, state, 0.0, 0.02 * math.sin(2.0 * math.pi * hum * PERIOD * k), 0.0
            )
            voltages.append(voltage)
        last = np.array(voltages[-500:])
        return float(np.std(last))

    with_it, without = swing(hum), swing(0.0)
    assert without > 0.05 and with_it < 1e-3 * without


PERIOD, SUBSTEPS = 0.001, 10
COIL, GAIN, A1, A0 = 0.004, 0.9, 90.5, 3198.0  # 9 Hz
MODEL = {
    "dcarc.model": "custom",
    "dcarc.numerator": [GAIN * A0],
    "dcarc.denominator": [COIL, 1.0 + A1 * COIL, A1 + A0 * COIL, A0],
}
WIDE = {"reshaping.max_rate": 1e5, "reshaping.max_accel": 1e7}
ALONE = {"dcarc.theta_spread": [0.0] * 9}  # the weights of the magnet alone learn
LEARNS = {"dcarc.fit_noise": 0.4}


def motion(samples):
    """Two sines that swell, with the two samples more that ``unreshaped`` takes."""
    t = np.arange(samples + 2) * PERIOD
    swell = np.square(0.5 - 0.5 * np.cos(math.pi * np.minimum(t / 0.2, 1.0)))
    return swell * (np.sin(4.0 * math.pi * t) + 0.3 * np.sin(12.6 * math.pi * t))


def error(p, half=0.0, positive=1.0, coulomb=0.0, samples=3000):
    """Rms error [V] of the last second and the last state of the law; bristles (Dahl) rub the spool."""
    dt = PERIOD / SUBSTEPS
    wanted = motion(samples)
    s = dcarc.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    force = play = x = v = z = 0.0
    share, errors = -math.expm1(-dt / COIL), []
    for k, command in enumerate(delivery.unreshaped(p.reshaping, wanted)):
        errors.append(x - wanted[k])
        voltage, s, _ = dcarc.step(p, s, float(command), x, 0.0)
        for _ in range(SUBSTEPS):
            force += share * (voltage - force)
            play = min(max(play, force - half), force + half)
            pull = play * positive if play > 0.0 else play
            stiff = A0 * GAIN * coulomb / 0.02 * dt
            v = (v + dt * A0 * (GAIN * (pull - coulomb * z) - x)) / (1.0 + dt * A1 + dt * stiff)
            z = (z + dt * v / 0.02) / (1.0 + dt * abs(v) / 0.02)
            x += dt * v
    return float(np.sqrt(np.mean(np.square(errors[-1000:])))), s


def law(**changes):
    return dcarc.build(controller(**MODEL, **WIDE, **changes))


def test_a_disturbance_behind_the_coil_moves_the_model_like_a_force_on_the_spool():
    """The observer's column of it against the step response of spool and spring alone."""
    model = dcarc_design.TransferFunction(tuple(MODEL["dcarc.numerator"]), tuple(MODEL["dcarc.denominator"]))
    made = dcarc_design.readings(model, PERIOD, 0.0, COIL)
    x, found = np.append(np.zeros(3), 1.0), []
    for _ in range(80):
        found.append(x[0])
        x = made.a @ x
    times = np.arange(80) * PERIOD
    _, expected = scipy.signal.step(([GAIN * A0], [1.0, A1, A0]), T=times)
    assert np.allclose(found, expected, atol=1e-9)


def test_hysteresis_and_unequal_gains_are_learned():
    """Twice the half width and 1.15 times the gain of one side: both weights find them, the error falls."""
    magnets = {"dcarc.coil": COIL, "dcarc.hysteresis": 0.05, "dcarc.sides": 0.1, **LEARNS, **ALONE}
    still, _ = error(law(**ALONE), half=0.1, positive=1.15)
    learned, s = error(law(**magnets), half=0.1, positive=1.15)
    assert learned < 0.25 * still
    assert s.magnet.weights.direction == pytest.approx(0.1, rel=0.2)
    assert s.magnet.weights.positive == pytest.approx(1.0 / 1.15 - 1.0, rel=0.2)


def delayed(p, delay, sensor=0.0, samples=1500):
    """Rms error [V] of a nominal valve whose voltage and reading are late, exact between the samples."""
    fine = 20
    part = PERIOD / fine
    a, b, c, d = scipy.signal.tf2ss(MODEL["dcarc.numerator"], MODEL["dcarc.denominator"])
    a, b, *_ = scipy.signal.cont2discrete((a, b, c, d), part)
    wanted = motion(samples)
    s = dcarc.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    x, sent, positions, seen = np.zeros(3), [], [0.0], []
    for command in delivery.unreshaped(p.reshaping, wanted):
        now = len(positions) - 1
        reading = positions[max(now - round(sensor / part), 0)]
        voltage, s, terms = dcarc.step(p, s, float(command), reading, 0.0)
        seen.append((positions[now], terms.position))
        sent += [voltage] * fine
        for _ in range(fine):
            at = len(positions) - 1 - round(delay / part)
            x = a @ x + b[:, 0] * (sent[at] if at >= 0 else 0.0)
            positions.append(float(c[0] @ x))
    found = np.array(seen)
    late = slice(300, None)
    error = found[:, 0] - wanted[: len(found)]
    return (float(np.sqrt(np.mean(np.square(e[late])))) for e in (error, found[:, 0] - found[:, 1]))


@pytest.mark.parametrize(
    ("delay", "sensor"), [(0.0003, 0.0), (0.001, 0.0005), (0.0026, 0.0), (0.0032, 0.0013), (0.004, 0.0)]
)
def test_a_dead_time_of_the_actuator_that_is_known_costs_nothing(delay, sensor):
    """Observer, feedback and preview account for it; unknown it costs fifty times as much."""
    own = {"dcarc.delay": sensor, **ALONE}
    error, unseen = delayed(law(dcarc__actuator_delay=delay, **own), delay, sensor)
    without, _ = delayed(law(**own), delay, sensor)
    assert error < 1.5e-3 and unseen < 1e-4
    assert without > 5.0 * error


@pytest.mark.parametrize("delay", [0.0007, 0.002])
def test_the_loop_with_a_dead_time_has_the_poles_of_filter_and_regulator(delay):
    """Feedback of the state when the voltage begins to act leaves the poles of the loop without dead time."""
    p = law(dcarc__actuator_delay=delay, dcarc__coil=COIL)
    free = law(dcarc__coil=COIL)
    poles = [abs(stability.pole_of(dcarc.LAW, one, stability.believed(dcarc.LAW, one))) for one in (p, free)]
    assert poles[0] == pytest.approx(poles[1], abs=1e-5)
    assert stability.warning(dcarc.LAW, p) == ""


@pytest.mark.parametrize("presliding", [0.0, 0.02])
def test_a_simulated_valve_with_solenoids_is_known_by_voltages(presliding):
    """Forces over the mean gain of both sides; weights are bounded; presliding stays if there is none."""
    plant = {
        "valve": "solenoid", "solenoid__positive": 1.3, "solenoid__negative": 1.0,
        "solenoid__coil": 0.004, "solenoid__hysteresis": 0.3, "solenoid__dead_time": 0.001,
        "friction__coulomb": 0.575, "friction__presliding": presliding, "disturbance__offset": 0.23,
    }  # fmt: skip
    values = controller(dcarc__theta_max=[0.4 if k == 2 else 100.0 for k in range(9)])
    known = dcarc.LAW.of_plant(values, valve(**plant))
    theta = known.pop("dcarc.theta_initial")
    assert (theta[2], theta[6]) == (0.4, pytest.approx(-0.2))
    slides = [share * presliding for share in dcarc.PRESLIDINGS]
    assert known.pop("dcarc.presliding", [0.0] * len(slides)) == slides
    assert known == pytest.approx(
        {"dcarc.coil": 0.004, "dcarc.hysteresis": 0.15, "dcarc.sides": 0.3, "dcarc.delay": 0.0,
         "dcarc.actuator_delay": 0.001}
    )  # fmt: skip
    assert dcarc.LAW.of_plant(values, valve()) == {}
