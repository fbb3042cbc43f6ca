# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A hum in the reading under dcarc.hum: it leaves the voltage, and costs little of the margins."""

import math

import numpy as np
import pytest

from research import coil
from valve_control.control.laws import dcarc, dcarc_design
from valve_control.control.laws.signals import Start
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import models
from valve_control.parameter import updated

PERIOD = 0.001
NOTCH = [(name, hum) for name in coil.VALVES for hum in (50.0, 60.0)]


def controller(name, hum, **changes):
    return updated(CONTROLLER, coil.controller(coil.VALVES[name], coil.TERMS), {"dcarc.hum": hum, **changes})


@pytest.mark.parametrize(("name", "hum"), NOTCH)
def test_what_is_known_of_the_hum_decays_at_the_width(name, hum):
    """The pole of the whole observer at the hum, against the walk that the derivation gives for its width."""
    values, turn = controller(name, 0.0), 2.0 * math.pi * hum * PERIOD
    model = models.chosen(values, "dcarc.model", "dcarc.")
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
        p = dcarc.build(controller(name, notch))
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
