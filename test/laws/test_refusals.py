# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Values with which a law cannot work are refused in one sentence that has the parameter's name."""

import changed
import pytest

from valve_control.control.laws import compensator_design
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.parameter import ParameterError

DESIGNED = {"controller": "compensator", "compensator__design": "designed"}
LAG = ((1200.0,), (1.0, 40.0, 1200.0))  # with two poles and no zero


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"controller": "pid", "pid__theta": [20.0, 1200.0, 0.0]},
      "pid.theta[2] (b0) is 0; it must be positive"),
     ({"controller": "pid", "pid__break_frequency": 1.0},
      "pid.break_frequency is 1 Hz, which is slower than the"),
     ({"arc__theta_min": [40.0, 1000.0, 1000.0, -500.0], "arc__theta_max": [30.0, 1500.0, 1500.0, 500.0]},
      "arc.theta_min[0] (a1) is 40, above arc.theta_max[0], 30"),
     ({"arc__theta_initial": [20.0, 1200.0, 1e6, 0.0]},
      "arc.theta_initial[2] (b0) is 1e+06; it must lie between"),
     ({"arc__theta_min": [-1e6, -1e6, 0.0, -1e6]}, "arc.theta_min[2] (b0) is 0; it must be positive"),
     ({**DESIGNED, "compensator__order": 1}, "compensator.order is 1; with fewer than "),
     ({**DESIGNED, "compensator__order": 6, "compensator__model": "fourth_order"},
      "the compensator would have 8 poles; it may have 6"),
     ({"reshaping__natural_frequency": 9000.0},
      "reshaping.natural_frequency is 9000 rad/s; at a sample period of"),
     ({"linearisation__enabled": True, "linearisation__voltage": [-10.0, 0.0, 10.0]},
      "linearisation.voltage has 3 points and linearisation.position 2; they must have as many"),
     ({"linearisation__enabled": True, "linearisation__voltage": [10.0, -10.0]},
      "linearisation.voltage[1] is -10 V; it must be above linearisation.voltage[0], 10 V"),
     ({"linearisation__enabled": True, "linearisation__voltage": [1.0], "linearisation__position": [1.0]},
      "linearisation.voltage has 1 point; it must have 2 to 32"),
     ({"linearisation__enabled": True, "linearisation__position": [1.0, 10.0]},
      "the curve of linearisation.position does not pass 0 V between -10 and 10 V"),
     ({"linearisation__enabled": True, "linearisation__voltage": [-10.0, 0.0, 1.0],
       "linearisation__position": [-10.0, 1.0, 1.0001]},
      "the curve of linearisation.position rises by 0.0001 V/V behind point 1; it must be between"),
     ({"controller": "dcarc", "dcarc__model": "custom", "dcarc__numerator": [1.0, 9.0, 9.0]},
      "the model of dcarc has "),
     ({"controller": "dcarc", "dcarc__model": "custom", "dcarc__numerator": [-1.0, 9.0],
       "dcarc__denominator": [1.0, 20.0, 300.0, 4000.0]}, "the model of dcarc has a zero at 9 rad/s"),
     ({"controller": "dcarc", "dcarc__hum": 5.0}, "dcarc.hum is 5 Hz; it must be 0 or at least"),
     ({"controller": "dcarc", "dcarc__hum": 600.0},
      "dcarc.hum is 600 Hz; it must lie below half of the sample rate")],
)  # fmt: skip
def test_a_controller_is_not_built(changes, said):
    with pytest.raises(ParameterError) as error:
        build.law_params(changed.controller(**changes))
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("model", "bandwidth", "said"),
    [(LAG, 0.0, "compensator.bandwidth is 0 Hz; it must be positive"),
     (((1.0, 1.0, 1.0), (1.0, 2.0)), 10.0, "the model is improper: it has 2 zeros and 1 poles"),
     (((2.0,), (1.0,)), 10.0, "the model has no poles, so there is nothing to compensate"),
     (((9.0,), (1.0, -2.0, 9.0)), 10.0, "the model has a pole at"),
     (((1.0, 0.0), (1.0, 40.0, 1200.0)), 10.0, "the model has a zero at 0 rad/s, so its static gain")],
)  # fmt: skip
def test_a_compensator_is_not_designed(model, bandwidth, said):
    with pytest.raises(ParameterError) as error:
        compensator_design.pole_zero_compensator(TransferFunction(*model), bandwidth)
    assert said in str(error.value)


class Noted(dict):
    """Values that note in ``read`` which of them are read."""

    def __getitem__(self, name):
        self.read.add(name)
        return super().__getitem__(name)


@pytest.mark.parametrize("law", LAWS)
def test_only_what_changed_is_built_again(law):
    """A law reads no other law's parameters: so an accepted one stays as it is when another changes."""
    values = Noted(changed.controller())
    values.read = set()
    LAWS[law].build(values)
    assert values.read and {n.partition(".")[0] for n in values.read} & LAWS.keys() <= {law}
    refused = changed.controller(oarc__theta_min=[-1e6, -1e6, 0.0, -1e6])
    assert build.law_params(refused, {**refused, "arc.k1": 1.0}) == build.law_params(changed.controller())
    with pytest.raises(ParameterError, match="oarc.theta_min"):
        build.law_params(refused, changed.controller())
