"""Third order, and friction that swings on its bristles: the fitted valve is the true one."""

import numpy as np
import pytest
from supervised import SupervisedValve, driven

from valve_control.commissioning import plant, small_signal
from valve_control.commissioning.bench import Limits

LIMITS = Limits(4.0, 2.0)


def silent(*done):
    pass


def found(valve, told=silent):
    """What commissioning fits to the readings of ``valve``."""
    rest, slow, static, planned, sine = driven(SupervisedValve(valve), LIMITS)
    _, fits, friction = small_signal.linear(sine, planned, static, rest)
    return plant.fitted([slow, sine], fits, friction, static.offset, rest, told)


def third(speed, damping, pole, gain):
    denominator = np.polymul([1.0, 2.0 * damping * speed, speed**2], [1.0, pole])
    return {
        "valve": "custom",
        "numerator": [gain * float(denominator[-1])],
        "denominator": [float(c) for c in denominator],
    }


def test_a_third_pole_is_no_dead_time():
    """A second order takes the pole at 55 Hz for 2.9 ms of dead time."""
    valve = {**third(100.0, 0.7, 350.0, 0.9), "friction.coulomb": 0.3, "friction.presliding": 0.02}
    made = found({**valve, "lvdt.delay": 0.0004, "lvdt.noise": 0.003})
    assert len(made.model.denominator) == 4 and made.presliding == 0.0
    assert made.delay == pytest.approx(0.0004, abs=0.0003)
    slow = sorted(abs(np.roots(made.model.denominator)))
    # Bristles, which this model lacks, stiffen small motions; of a fast pole little but its lag shows.
    assert slow[:2] == pytest.approx([100.0, 100.0], rel=0.15) and slow[2] == pytest.approx(350.0, rel=0.35)


@pytest.mark.campaign
def test_a_spool_that_swings_on_its_bristles():
    """It moves at a fifth of its friction; without bristles the error is 19 times what is allowed."""
    told = []
    valve = {**third(39.6, 0.6, 220.0, 1.07), "friction.coulomb": 1.37, "friction.static_ratio": 1.34}
    valve |= {"friction.presliding": 0.02, "friction.stribeck_velocity": 0.017, "lvdt.delay": 0.0018}
    made = found({**valve, "lvdt.noise": 0.0014}, lambda done, total: told.append(done / total))
    assert made.error < 6.0 and 0.005 < made.presliding < 0.05
    assert made.friction.coulomb == pytest.approx(1.37, rel=0.1)
    assert made.model.static_gain == pytest.approx(1.07, rel=0.1)
    assert min(told) > 0.0 and max(told) <= 1.0 and len(told) > 500
