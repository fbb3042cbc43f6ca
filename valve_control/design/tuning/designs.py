# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives gains of dcarc and of the PID with which a search begins, from the valves of the box.

On a model with three more poles than zeros hardly any of the gains in the ranges of dcarc keep the margins,
so that a small search finds none at all. LQR and Kalman filter are designed for a few bandwidths here, from
loops that are tight on a valve that is known well to loops that bear another gain and speed. The reference
filter has a lead that makes up for all of its lag.

The PID is that of internal model control (Rivera, Morari and Skogestad 1986): it is the reciprocal of the
valve, up to the second power of s, over λ·s. Its loop is an integrator at low frequencies, whatever the poles
of the valve, coil and dead time included. λ follows from the gain margin that is left on the worst valve.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

from valve_control.control.laws import dcarc, pid, reshaping
from valve_control.control.laws.dcarc_design import EXCESS, excess
from valve_control.control.laws.law import Law
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import models
from valve_control.control.plant.models import Scale
from valve_control.design.tuning import margins
from valve_control.parameter import ParameterError, Value, Values, number, updated, word

LOOPS = ((0.05, 4.0), (0.15, 2.0), (0.5, 4.0), (0.5, 2.0))  # weight at the gain of the D3FXE, V/√s
SHARES = (0.35, 0.55, 0.85)  # of the highest natural frequency of the reference filter
INPUT_NOISE, FIT_NOISE, FORGETTING = 0.5, 0.4, 0.05  # V, V, 1/s
RUBBING, LEAST = 0.3, 0.1  # of the friction that is known, and V: spread of the weights of bristles
OTHERS = (0.1, 0.1, 0.2, 0.0, 0.0)  # of gain, and of flow force, offset, damping and inertia
SLOW, QUICK = 0.2, 1.0  # of the frequency at which the valve is 90° late: where 1/G is matched
LEFT = (1.8, 2.2, 3.0)  # times the gain, which the worst valve of the box bears
CUTOFFS = (2.5, 6.0)  # of the derivative's low-pass, over 1/λ
LEAST_CUTOFF, MOST_CUTOFF = 1.0, 1e4  # Hz
LOOSE = 10.0  # times c1 of the valve, for λ of a loop that is stable
STATIC = 0.35  # of 1/gain, as the static feedforward of the plain form
REFERENCE = 0.85  # of the highest natural frequency of the reference filter


class Reciprocal(NamedTuple):
    """Voltage for a motion: c0·x + c1·dx/dt + c2·d²x/dt²."""

    c0: float  # V/V
    c1: float  # s
    c2: float  # s²


def starts(law: Law, values: Values, preview: bool, scale: Scale, box: margins.Box) -> list[Values]:
    """Parameters of the controller from which a search of ``law`` begins besides ``values``.

    ``box``: the valves on which margins have to hold. Those that ``law`` cannot be built with are left out.
    """
    if law.name == "pid":
        return _pids(values, preview, scale, box)
    return _dcarcs(law, values, preview, scale)


def reciprocal(box: margins.Box, share: float) -> Reciprocal | None:
    """1/G of the median valve, matched at rest and at ``share`` of the frequency of a lag of 90°.

    None: the valve has no such frequency, or another form.
    """
    inverse = np.median(1.0 / box.response.real[:, 0]), np.median(1.0 / box.response, axis=0)
    c0, away = float(inverse[0]), inverse[1]
    late = np.flatnonzero(away.real * c0 <= 0.0)
    if not len(late) or c0 <= 0.0:
        return None
    k = int(np.argmin(np.abs(box.omega - share * box.omega[late[0]])))
    w = float(box.omega[k])
    found = Reciprocal(c0, float(away.imag[k]) / w, (c0 - float(away.real[k])) / (w * w))
    return found if min(found) > 0.0 else None


def _pids(values: Values, preview: bool, scale: Scale, box: margins.Box) -> list[Values]:
    """PIDs of a few bandwidths; the feedforward of the reference form is 1/G of slow motions."""
    slow = reciprocal(box, SLOW)
    if slow is None or word(values, "pid.form") == "paper":
        return []
    made = []
    for share, cutoff, left in itertools.product((SLOW, QUICK), CUTOFFS, LEFT):
        shape = reciprocal(box, share)
        if shape is None:
            continue
        try:
            tight = _tightest(values, shape, MOST_CUTOFF, box)
            closest = _tightest(values, shape, cutoff / tight / (2.0 * math.pi), box)
            loop = _gains(shape, left * closest, cutoff / tight / (2.0 * math.pi))
            made.append(_fed(updated(CONTROLLER, values, loop), slow, left * closest, preview, scale))
        except ParameterError:
            continue
    return made


def _gains(shape: Reciprocal, filtered: float, cutoff: float) -> dict[str, Value]:
    """Gains of the PID (c0 + c1·s + c2·s²)/(λ·s) with λ ``filtered`` [s] and the ``cutoff`` [Hz]."""
    return {
        "pid.break_frequency": 0.0,
        "pid.kp": shape.c1 / filtered,
        "pid.ki": shape.c0 / filtered,
        "pid.kd": shape.c2 / filtered,
        "pid.derivative_cutoff": min(MOST_CUTOFF, max(LEAST_CUTOFF, cutoff)),
    }


def _tightest(values: Values, shape: Reciprocal, cutoff: float, box: margins.Box) -> float:
    """λ [s] with which the loop of one valve of the ``box`` is at the edge of stability.

    All gains go with 1/λ, so that it follows from the gain margin with any λ. Raises ParameterError.
    """
    loose = LOOSE * shape.c1 / shape.c0
    params = pid.build(updated(CONTROLLER, values, _gains(shape, loose, cutoff)))
    left = float(np.min(margins.margins(pid.LAW, params, box).gain_db))
    if not 0.0 < left < math.inf:
        raise ParameterError("the loop has no gain at which it becomes unstable")
    return loose * 10.0 ** (-left / 20.0)


def _fed(values: Values, slow: Reciprocal, filtered: float, preview: bool, scale: Scale) -> Values:
    """``values`` of a PID with λ ``filtered`` [s] and a feedforward; raises ParameterError.

    With a static one of a share x of c0 the plain form is late by (1 - x)·λ on a ramp, which the lead of the
    command makes up for. In the reference form it makes up for that of the reference filter.
    """
    if word(values, "pid.form") == "plain":
        plain: Values = {"pid.static_feedforward": STATIC * slow.c0}
        led = {} if preview else {"reshaping.lead": (1.0 - STATIC) * filtered, "reshaping.lead_accel": 1.0}
        return updated(CONTROLLER, values, {**plain, **led})
    made = updated(CONTROLLER, values, {"pid.theta": [slow.c1 / slow.c2, slow.c0 / slow.c2, 1.0 / slow.c2]})
    if preview:
        return made
    highest = reshaping.frequency(values, scale).high
    made = updated(CONTROLLER, made, {"reshaping.natural_frequency": REFERENCE * highest})
    return updated(CONTROLLER, made, {"reshaping.lead": reshaping.lag(made), "reshaping.lead_accel": 1.0})


def _dcarcs(law: Law, values: Values, preview: bool, scale: Scale) -> list[Values]:
    """Gains of dcarc; none of a law that has no coil in its model."""
    if law is not dcarc.LAW or excess(models.chosen(values, "dcarc.model", "dcarc.")) <= EXCESS[0]:
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
