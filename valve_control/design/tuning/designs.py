# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives gains of dcarc with which a search begins on a valve with a coil.

On a model with three more poles than zeros hardly any of the gains in the ranges keep the margins, so that a
small search finds none at all. LQR and Kalman filter are designed for a few bandwidths here, from loops that
are tight on a valve that is known well to loops that bear another gain and speed. The reference filter has a
lead that makes up for all of its lag.
"""

import itertools

from valve_control.control.laws import dcarc, reshaping
from valve_control.control.laws.dcarc_design import EXCESS, excess
from valve_control.control.laws.law import Law
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import models
from valve_control.control.plant.models import Scale
from valve_control.parameter import ParameterError, Values, number, updated

LOOPS = ((0.05, 4.0), (0.15, 2.0), (0.5, 4.0), (0.5, 2.0))  # weight at the gain of the D3FXE, V/√s
SHARES = (0.35, 0.55, 0.85)  # of the highest natural frequency of the reference filter
INPUT_NOISE, FIT_NOISE, FORGETTING = 0.5, 0.4, 0.05  # V, V, 1/s
RUBBING, LEAST = 0.3, 0.1  # of the friction that is known, and V: spread of the weights of bristles
OTHERS = (0.1, 0.1, 0.2, 0.0, 0.0)  # of gain, and of flow force, offset, damping and inertia


def starts(law: Law, values: Values, preview: bool, scale: Scale) -> list[Values]:
    """Parameters of the controller from which a search of ``law`` begins besides ``values``.

    None of a law that has no coil in its model. Those that ``law`` cannot be built with are left out.
    """
    if law.name != dcarc.LAW.name or excess(models.chosen(values, "dcarc.model", "dcarc.")) <= EXCESS[0]:
        return []
    close = max(LEAST, RUBBING * float(list(values["dcarc.theta_initial"])[2]))  # type: ignore[arg-type]
    common: Values = {
        "dcarc.input_noise": INPUT_NOISE,
        "dcarc.fit_noise": FIT_NOISE,
        "dcarc.forgetting": FORGETTING,
        "dcarc.theta_spread": [OTHERS[0], *([close] * 4), *OTHERS[1:]],
    }
    highest = reshaping.frequency(values, scale).high
    made = []
    for (weight, rate), share in itertools.product(LOOPS, (1.0,) if preview else SHARES):
        loop: Values = {
            **common,
            "dcarc.voltage_weight": weight * scale.gain**2,
            "dcarc.disturbance_rate": rate,
        }
        if not preview:
            loop["reshaping.natural_frequency"] = share * highest
            loop["reshaping.lead_accel"] = 1.0
        try:
            changed = updated(CONTROLLER, values, loop)
            if not preview:
                changed = updated(CONTROLLER, changed, {"reshaping.lead": _lag(changed)})
            law.build(changed)
        except ParameterError:
            continue
        made.append(changed)
    return made


def _lag(values: Values) -> float:
    """Time [s] by which the spool is late after a command: filter (8), that behind it, and dead time."""
    own = dcarc.build(values).reshaping
    return reshaping.lag(values) + 1.0 / own.smoothing + number(values, "dcarc.actuator_delay")
