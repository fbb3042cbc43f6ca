# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Chooses parameters of dcarc for a valve that is known: its model, coil and play, and gains to search from.

On a model with three more poles than zeros hardly any of the gains in the ranges of dcarc keep the margins,
so that a small search finds none at all. LQR and Kalman filter are designed for a few bandwidths here, from
loops that are tight on a valve that is known well to loops that bear another gain and speed.
"""

from valve_control.control.laws.least_squares import Weights
from valve_control.control.plant import models
from valve_control.control.plant.models import Scale, TransferFunction
from valve_control.parameter import Values, number, numbers

PRESLIDINGS = (0.4, 1.0, 2.5)  # of the three bristles over that of the valve
LOOPS = ((0.05, 4.0), (0.15, 2.0), (0.5, 4.0), (0.5, 2.0))  # weight at the gain of the D3FXE, V/√s
INPUT_NOISE, FIT_NOISE, FORGETTING = 0.5, 0.4, 0.05  # V, V, 1/s
RUBBING, LEAST = 0.3, 0.1  # of the friction that is known, and V: spread of the weights of bristles
OTHERS = (0.1, 0.1, 0.2, 0.0, 0.0)  # of gain, and of flow force, offset, damping and inertia


def of_model(model: TransferFunction, period: float) -> TransferFunction:
    """The ``model`` of a valve as the law takes it at ``period`` [s]."""
    from valve_control.control.laws.dcarc_design import without_fast_zero  # scipy.linalg takes a while

    return without_fast_zero(model, period)


def of_plant(values: Values, plant: Values) -> Values:
    """Coil, play, friction and unequal gains of a simulated ``plant`` with solenoids; {}: it has none.

    Friction and offset are those of the law's model: voltages at its input, whose gain is the mean of both
    sides (``solenoid_valve.transfer``). ``values``: of the controller.
    """
    if plant["valve"] != "solenoid":
        return {}
    positive, negative = number(plant, "solenoid.positive"), number(plant, "solenoid.negative")
    side = 0.5 * (positive + negative)  # force per voltage
    weights = Weights(*numbers(values, "dcarc.theta_initial"))._replace(
        bristle2=number(plant, "friction.coulomb") / side,
        offset=-number(plant, "disturbance.offset") / side,
    )
    low, high = (numbers(values, f"dcarc.theta_{end}") for end in ("min", "max"))
    made: Values = {
        "dcarc.coil": number(plant, "solenoid.coil"),
        "dcarc.hysteresis": 0.5 * number(plant, "solenoid.hysteresis"),
        "dcarc.sides": min(abs(positive / negative - 1.0), 1.0),
        "dcarc.actuator_delay": number(plant, "solenoid.dead_time"),
        "dcarc.delay": number(plant, "lvdt.delay"),
        "dcarc.theta_initial": [
            min(max(w, least), most) for w, least, most in zip(weights, low, high, strict=True)
        ],
    }
    if number(plant, "friction.presliding") > 0.0:
        made["dcarc.presliding"] = [share * number(plant, "friction.presliding") for share in PRESLIDINGS]
    return made


def starts(values: Values, scale: Scale) -> list[Values]:
    """Gains to begin a search with, on a valve of this ``scale``; none with two more poles than zeros."""
    from valve_control.control.laws.dcarc_design import EXCESS, excess

    if excess(models.chosen(values, "dcarc.model", "dcarc.")) <= EXCESS[0]:
        return []
    close = max(LEAST, RUBBING * Weights(*numbers(values, "dcarc.theta_initial")).bristle2)
    common: Values = {
        "dcarc.input_noise": INPUT_NOISE,
        "dcarc.fit_noise": FIT_NOISE,
        "dcarc.forgetting": FORGETTING,
        "dcarc.theta_spread": [OTHERS[0], *([close] * 4), *OTHERS[1:]],
    }
    return [
        {**common, "dcarc.voltage_weight": weight * scale.gain**2, "dcarc.disturbance_rate": rate}
        for weight, rate in LOOPS
    ]
