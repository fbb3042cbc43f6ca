# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the controller gets to know of a valve that was found."""

import numpy as np
import pytest

from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import linear_loop
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.models import TransferFunction
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.valve import FREE
from valve_control.design.commissioning.evaluation import Friction, Rest
from valve_control.design.commissioning.model import Known, controller_values
from valve_control.design.commissioning.plant import Plant
from valve_control.parameter import defaults, updated

REST = Rest(0.0, 0.0135, 0.0)
PERIOD = 0.001
# A valve of third order and 34.8 Hz, as commissioning fitted it by a fourth order: a zero at 6733 rad/s.
FAST = TransferFunction(
    (-3133.8918666956183, 21013033.272194702, 590274685.061358),
    (1.0, 741.1870128263236, 246628.41126594495, 34978195.47116466, 837532906.9849794),
)


# A valve of third order and 6.3 Hz, which a second order takes for one with 4.6 ms of dead time.
SLOW = TransferFunction((341574.4,), (1.0, 267.513, 14527.99, 320269.9))


def known(model, law, delay=0.0):
    return Known(Plant(model, Friction(0.34, 1.37), 0.0, delay, 1.5), REST, PERIOD, 10.0, law)


def loop_poles(values, model, delay):
    """Of dcarc with ``values`` around ``model``, whose readings are ``delay`` periods late."""
    law = LAWS["dcarc"]
    params = law.build(updated(CONTROLLER, defaults(CONTROLLER), values))
    plant = valve.design(model, PERIOD, 10.0, 1.0, FREE, IDEAL._replace(delay=delay))
    return linear_loop.dominant_poles(linear_loop.linear_law(law, params), linear_loop.linear_valves([plant]))


def test_a_zero_beyond_the_samples_is_taken_out():
    """No lower order is needed. With the model of the D3FXE dcarc came out at 320 mV."""
    found = known(FAST, "dcarc")
    values = controller_values(found, "dcarc")
    assert values["dcarc.denominator"] == pytest.approx(FAST.denominator)
    (zero,) = np.roots(values["dcarc.numerator"])
    assert zero == pytest.approx(max(np.roots(FAST.numerator), key=lambda z: -abs(z)))
    assert values["dcarc.numerator"][-1] / values["dcarc.denominator"][-1] == pytest.approx(FAST.static_gain)
    assert found.notes == ()
    assert np.max(np.abs(loop_poles(values, FAST, 0.0))) < 1.0


def test_a_zero_that_cannot_be_inverted_leaves_a_model_of_lower_order():
    """The loop is stable on the valve found."""
    right = TransferFunction((-SLOW.numerator[0] / 200.0, SLOW.numerator[0]), SLOW.denominator)
    found = known(right, "dcarc")
    values = controller_values(found, "dcarc")
    assert values["dcarc.model"] == "custom" and len(values["dcarc.denominator"]) == 3
    gain = values["dcarc.numerator"][-1] / values["dcarc.denominator"][-1]
    assert gain == pytest.approx(right.static_gain, rel=0.02)
    assert "dcarc gets a model of order 2 with 4 ms of dead time" in found.notes[0]
    assert "a zero at 200 rad/s and cannot be inverted" in found.notes[0]
    assert np.max(np.abs(loop_poles(values, right, 0.0))) < 1.0


def test_a_third_order_without_zeros_goes_to_dcarc_as_it_is():
    """Before: a model of order 2 with 4 ms of dead time."""
    values = controller_values(known(SLOW, "dcarc", 0.0023), "dcarc")
    assert values["dcarc.denominator"] == list(SLOW.denominator)
    assert values["dcarc.actuator_delay"] == pytest.approx(0.0023)
    assert values["dcarc.delay"] == 0.0
    assert np.max(np.abs(loop_poles(values, SLOW, 2.3))) < 1.0
