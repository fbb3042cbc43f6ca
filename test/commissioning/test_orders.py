# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Third order with friction: the fitted valve is the true one."""

import numpy as np
import pytest
from supervised import SupervisedValve, fitted

from valve_control.design.commissioning.bench import SafetyLimits

LIMITS = SafetyLimits(4.0, 2.0)


def found(valve, tell=lambda: None, limits=LIMITS):
    """What commissioning fits to the readings of ``valve``."""
    period = {name: value for name, value in valve.items() if name == "sample_period"}
    return fitted(SupervisedValve(valve, period), limits, tell)


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
