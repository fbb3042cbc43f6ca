# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Laws that know no coil are warned of where the controller's parameters tell of one."""

import math
import re

import numpy as np
import pytest

from research import coil
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import stability
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.models import TransferFunction
from valve_control.control.plant.sensor import IDEAL
from valve_control.parameter import updated


def known(name, law, **changes):
    values = coil.controller(coil.VALVES[name], coil.TERMS)
    return updated(CONTROLLER, values, {"controller": law, **changes})


@pytest.mark.parametrize(("name", "law"), [("A", "arc"), ("B", "arc"), ("B", "oarc"), ("B", "pid")])
def test_the_warning_has_the_pole_of_the_loop_with_the_coil(name, law):
    """Against the loop around a valve of that transfer function, which is sampled on another way."""
    values = known(name, law)
    params = LAWS[law].build(values)
    said = stability.coil_warning(LAWS[law], params, values)
    model = TransferFunction(tuple(values["dcarc.numerator"]), tuple(values["dcarc.denominator"]))
    plant = valve.design(model, params.period, params.u_max, 1.25, valve.FREE, IDEAL)
    pole = stability.dominant_pole(LAWS[law], params, plant)
    found = re.search(r"model of dcarc.*pole of the sampled loop: ([\d.]+), at ([\d.]+) Hz", said)
    radius, frequency = map(float, found.groups())
    assert radius == pytest.approx(abs(pole), abs=6e-4)
    rate = abs(np.angle(pole)) / params.period
    assert frequency == pytest.approx(rate / (2.0 * math.pi), rel=0.01)
    assert stability.warning(LAWS[law], params) == ""  # on its own model all is well
