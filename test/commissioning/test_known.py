"""What the controller gets to know of a valve that was found."""

import numpy as np
import pytest

from valve_control.commissioning.model import Known, controller_values
from valve_control.commissioning.plant import Plant
from valve_control.commissioning.statics import Friction, Rest
from valve_control.laws.registry import LAWS
from valve_control.parameter import defaults, updated
from valve_control.parameters import linear_loop
from valve_control.parameters.stability import FREE, IDEAL
from valve_control.parameters.table import CONTROLLER
from valve_control.plant import valve
from valve_control.plant.models import TransferFunction

REST = Rest(0.0, 0.0135, 0.0)
PERIOD = 0.001
# A valve of third order and 34.8 Hz, as commissioning fitted it by a fourth order: a zero at 6733 rad/s.
FAST = TransferFunction(
    (-3133.8918666956183, 21013033.272194702, 590274685.061358),
    (1.0, 741.1870128263236, 246628.41126594495, 34978195.47116466, 837532906.9849794),
)


def known(model, law):
    return Known(Plant(model, Friction(0.34, 1.37), 0.0, 0.0, 1.5), REST, PERIOD, 10.0, law)


def test_zeros_that_cannot_be_inverted_leave_a_model_of_lower_order():
    """Not that of the D3FXE, with which dcarc came out at 320 mV. The loop is stable on the valve found."""
    found = known(FAST, "dcarc")
    values = controller_values(found, "dcarc")
    assert values["dcarc.model"] == "custom" and len(values["dcarc.denominator"]) == 4
    gain = values["dcarc.numerator"][-1] / values["dcarc.denominator"][-1]
    assert gain == pytest.approx(FAST.static_gain, rel=0.02)
    assert "dcarc gets a model of order 3" in found.notes[0]
    law = LAWS["dcarc"]
    params = law.build(updated(CONTROLLER, defaults(CONTROLLER), values))
    plant = valve.design(FAST, PERIOD, 10.0, 1.0, FREE, IDEAL)
    poles = linear_loop.dominant_poles(
        linear_loop.linear_law(law, params), linear_loop.linear_valves([plant])
    )
    assert np.max(np.abs(poles)) < 1.0


def test_a_law_without_a_model_of_its_own_in_the_first_gains_gets_none():
    """Of the compensator first_gains knows nothing, whether or not zeros can be inverted."""
    assert not [name for name in known(FAST, "compensator").gains if name.startswith("compensator.")]
