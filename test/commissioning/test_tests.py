# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the tests of a valve tell, on simulated valves whose numbers are known."""

import math

import numpy as np
import pytest
from supervised import SupervisedValve, driven, fitted

from benchmarks import solenoid
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.control.simulation import offline
from valve_control.design.commissioning import evaluation, valve_fit
from valve_control.design.commissioning.bench import Record, SafetyLimits
from valve_control.design.commissioning.valve_fit import Magnet
from valve_control.parameter import ParameterError, defaults, updated

LIMITS = SafetyLimits(4.0, 2.0)
VALVE = {
    "valve": "custom",
    "numerator": [40000.0],
    "denominator": [1.0, 280.0, 40000.0],
    "friction.coulomb": 0.5,
    "disturbance.offset": 0.3,
    "lvdt.noise": 0.005,
    "lvdt.delay": 0.0015,
}


def silent(done):
    pass


@pytest.fixture(scope="module")
def tested():
    """Rest, slow triangle and stepped sine of a valve that is seven times as fast as that of the paper."""
    bench = SupervisedValve(VALVE)
    return bench, *driven(bench, LIMITS)


def test_rest_tells_noise_and_position(tested):
    _, rest, *_ = tested
    assert rest.noise == pytest.approx(0.005, rel=0.1) and rest.resolution == 0.0


def test_slow_triangle_tells_gain_offset_friction_and_dead_zone(tested):
    bench, rest, _, static, *_ = tested
    assert static.gain == pytest.approx(1.0, rel=0.005)
    assert static.offset == pytest.approx(-0.3, abs=0.005)
    lag = 280.0 / 40000.0 + 0.0015
    friction = evaluation.friction_proper(static, lag, rest)
    assert friction.coulomb == pytest.approx(0.5, abs=0.01)
    # From one side to the other friction changes by twice its size before the spool moves.
    assert static.dead_zone == pytest.approx(1.0, abs=0.15)
    assert friction.static_ratio < 1.25
    assert max(map(abs, bench.readings)) <= LIMITS.travel
    assert max(map(abs, bench.voltages)) <= LIMITS.voltage


def test_simulated_under_the_same_voltages_the_fitted_valve_is_the_true_one(tested):
    _, rest, slow, static, planned, sine = tested
    response, fits, friction = evaluation.linear(sine, planned, static, rest)
    biased = fits[0].model.denominator[2]
    # A higher order would count only if it were better by more than rounding.
    found = valve_fit.fitted([slow, sine], fits, friction, static.offset, rest)
    b0, (_, a1, a0) = found.model.numerator[-1], found.model.denominator
    assert [b0, a0, a1] == pytest.approx([40000.0, 40000.0, 280.0], rel=0.03)
    assert abs(biased / 40000.0 - 1.0) > 0.1  # which the response alone does not give: the spool sticks
    assert found.delay == pytest.approx(0.0015, abs=1e-4)
    assert found.friction.coulomb == pytest.approx(0.5, abs=0.01)
    assert found.offset == pytest.approx(0.3, abs=0.005)


def record(voltage, reading):
    return Record(0.001, np.asarray(reading), np.asarray(voltage), np.asarray(voltage))


REST = evaluation.Rest(0.0, 0.002, 0.0)


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        (lambda u: 0.0 * u, "moved by 0 V alone"),
        (lambda u: -0.9 * u, "against the voltage"),
    ],
)
def test_a_valve_that_cannot_be_commissioned_is_told_in_one_sentence(reading, words):
    voltage = driven_triangle()
    with pytest.raises(ParameterError, match=words):
        evaluation.slow(record(voltage, reading(voltage)), REST)


def driven_triangle():
    quarter = np.linspace(0.0, 2.0, 1250, endpoint=False)
    whole = np.concatenate([quarter, 2.0 - quarter, -quarter, quarter - 2.0])
    return np.concatenate([whole, whole, [0.0]])


LINEAR = valve_fit.Plant(
    TransferFunction((5800.0,), (1.0, 110.0, 6400.0)), evaluation.Friction(0.8, 1.2), 0.1, 0.001, 1.0, 0.02
)
COILED = Magnet(
    speed=80.0, damping=0.75, coil=0.004, gain=0.9, sides=-0.03, hysteresis=0.1, overlap=0.0, coulomb=0.8,
    presliding=0.02, static_ratio=1.3, offset=-0.2, delay=0.0006,
)  # fmt: skip


@pytest.mark.parametrize("push", [2.5, -2.5])
@pytest.mark.parametrize("magnet", [None, COILED])
def test_a_spool_that_friction_holds_off_centre_is_no_error_of_the_model(magnet, push):
    """The true valve explains a triangle that begins where the motion before it has left the spool."""
    true = LINEAR if magnet is None else LINEAR._replace(offset=-0.2, magnet=magnet)
    before = push * np.interp(np.arange(2500) * 0.001, [0.0, 1.0, 2.0], [0.0, 1.0, 0.0])
    voltage = np.concatenate([before, 2.0 * driven_triangle()])
    nothing = record(voltage, np.zeros(len(voltage)))
    reading = valve_fit.simulated(true, nothing)[len(before) :]
    assert abs(reading[0]) > 0.3  # off the centre, under 0 V
    slow = record(voltage[len(before) :], reading)
    begin = valve_fit.first_reading(reading, slow.period)
    assert valve_fit.simulated(true, slow)[0] == pytest.approx(begin, abs=1e-6)
    weight = valve_fit._weight(slow, REST)
    assert np.sqrt(np.mean((weight * (valve_fit.simulated(true, slow) - reading)) ** 2)) < valve_fit.SUSPECT


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_bench_is_the_simulated_valve(seed):
    """The same readings, bit for bit, as those of an offline run."""
    values = solenoid.drawn(seed)
    bench = SupervisedValve(values, {"controller": "open_loop", "open_loop.static_gain": 1.0})
    wanted = [2.0 * math.sin(0.02 * k) for k in range(600)]
    record = bench.drive((value for value in wanted), SafetyLimits(10.0, 10.0), silent)
    controller = updated(CONTROLLER, defaults(CONTROLLER), bench.controller)
    run = offline.simulate(controller, values, np.array(wanted))
    assert record.voltage.tolist() == run.voltage.tolist()
    assert record.reading.tolist() == run.measurement.tolist()
    assert np.ptp(record.reading) > 0.3


def found(valve, limits=LIMITS):
    """What commissioning fits to the readings of ``valve``."""
    period = {name: value for name, value in valve.items() if name == "sample_period"}
    return fitted(SupervisedValve(valve, period), limits)


def third(speed, damping, pole, gain):
    denominator = np.polymul([1.0, 2.0 * damping * speed, speed**2], [1.0, pole])
    return {
        "valve": "custom",
        "numerator": [gain * float(denominator[-1])],
        "denominator": [float(c) for c in denominator],
    }


def responses(numerator, denominator, delay):
    """From 0.5 Hz to where a third of the size of 0.5 Hz is left of the valves here."""
    at = 2j * np.pi * np.geomspace(0.5, 25.0, 30)
    return np.polyval(numerator, at) / np.polyval(denominator, at) * np.exp(-at * delay)


def test_a_third_pole_is_no_dead_time():
    """A second order takes the pole at 55 Hz for 2.9 ms of dead time."""
    valve = third(100.0, 0.7, 350.0, 0.9)
    made = found({**valve, "lvdt.delay": 0.0004, "lvdt.noise": 0.003})
    assert len(made.model.denominator) == 4 and made.presliding == 0.0
    assert made.delay < 0.0007
    wanted = responses(valve["numerator"], valve["denominator"], 0.0004)
    assert responses(*made.model, made.delay) == pytest.approx(wanted, rel=0.06)


@pytest.mark.campaign
def test_a_third_pole_of_a_valve_with_friction_is_that_of_a_coil():
    """Its linear part is found; a valve with this linear part and friction ahead of it is explained too."""
    rubbing = {"friction.coulomb": 0.3, "friction.presliding": 0.02, "lvdt.noise": 0.003}
    speed = {"solenoid.natural_frequency": 100.0 / (2.0 * np.pi), "solenoid.damping": 0.7}
    coil = {"solenoid.coil": 1.0 / 350.0, "solenoid.gain": 0.9, "solenoid.dead_time": 0.0004}
    made = found({**rubbing, **speed, **coil, "valve": "solenoid"})
    assert made.magnet.coil == pytest.approx(1.0 / 350.0, rel=0.1)
    linear = third(100.0, 0.7, 350.0, 0.9)
    wanted = responses(linear["numerator"], linear["denominator"], 0.0004)
    assert responses(*made.model, made.delay) == pytest.approx(wanted, rel=0.06)
    ahead = found({**linear, **rubbing, "lvdt.delay": 0.0004})
    for one in (made, ahead):
        assert one.magnet.hysteresis < 0.04 and one.presliding == pytest.approx(0.02, abs=0.004)
        assert one.delay < 0.0007 and one.error < 0.75


@pytest.mark.campaign
def test_a_pole_that_the_samples_do_not_show_is_not_sought_for_ever():
    """At 250 Hz and with this noise the search of third order leads to exp(1200) rad/s."""
    valve = {"sample_period": 0.004, "friction.coulomb": 0.6, "disturbance.offset": 0.2, "seed": 5}
    made = found({**valve, "lvdt.noise": 0.004, "lvdt.delay": 0.0024}, limits=SafetyLimits(3.5, 1.5))
    assert made.friction.coulomb == pytest.approx(0.6, abs=0.03)
    assert made.model.static_gain == pytest.approx(0.829, rel=0.03)
    assert max(abs(np.roots(made.model.denominator))) < np.pi / 0.004
