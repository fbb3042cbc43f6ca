# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives gains with which a search begins: those of the law itself, or a PID for the valves of the box.

The reference filter of a law has a lead that makes up for all of its lag.

The PID is that of internal model control (Rivera, Morari and Skogestad 1986): it is the reciprocal of the
valve, up to the second power of s, over λ·s. Its loop is an integrator at low frequencies, whatever the poles
of the valve, coil and dead time included. λ follows from the gain margin that is left on the worst valve.
Others have more of the integral, or more damping, against friction.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

from valve_control.control.laws import reshaping
from valve_control.control.laws.law import Law
from valve_control.control.linear import margins
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.tuning.trial import Problem
from valve_control.parameter import ParameterError, Values, updated

SHARES = (0.4, 0.65, 0.95)  # of the highest natural frequency of the reference filter
SLOW, QUICK = 0.2, 1.0  # of the frequency at which the valve is 90° late: where 1/G is matched
# Of a PID: times c0, as viscous friction in c1, and times the gain that the worst valve bears.
SHAPES = ((1.0, 0.0, 1.9), (2.0, 0.0, 1.9), (1.5, 0.0, 2.8), (1.0, 1.0, 2.2))
CUTOFFS = (1.5, 5.0)  # of the derivative's low-pass, over 1/λ
LEAST_CUTOFF, MOST_CUTOFF = 1.0, 1e4  # Hz
LOOSE = 10.0  # times c1 of the valve, for λ of a loop that is stable
FED = (0.4, 0.8)  # of the friction, as viscous, in the feedforward; of 1/gain in that of the plain form
REFERENCE = 0.85  # of the highest natural frequency of the reference filter


class Reciprocal(NamedTuple):
    """Voltage for a motion: c0·x + c1·dx/dt + c2·d²x/dt²."""

    c0: float  # V/V
    c1: float  # s
    c2: float  # s²


def starts(law: Law, problem: Problem, box: margins.Box) -> list[Values]:
    """Parameters of the controller from which a search of ``law`` begins besides those of the ``problem``.

    ``box``: the valves of the problem on which margins have to hold. Those that ``law`` cannot be built with
    are left out.
    """
    return _shaped(law, problem) if law.inverse is None else _inverted(law, problem, box)


def reciprocal(box: margins.Box, share: float) -> Reciprocal | None:
    """1/G of the median valve, matched at rest and at ``share`` of the frequency of a lag of 90°.

    None: the valve has no such frequency, or another form.
    """
    each = 1.0 / box.response
    real, imag = np.median(each.real, axis=0), np.median(each.imag, axis=0)
    late = np.flatnonzero(real <= 0.0)
    if not len(late) or late[0] == 0:
        return None
    k = max(1, int(np.argmin(np.abs(box.omega - share * box.omega[late[0]]))))
    squares = box.omega**2
    c2 = float((real[0] - real[k]) / (squares[k] - squares[0]))
    found = Reciprocal(float(real[0] + c2 * squares[0]), float(imag[k] / box.omega[k]), c2)
    return found if min(found) > 0.0 else None


def _inverted(law: Law, problem: Problem, box: margins.Box) -> list[Values]:
    """Loops of a few bandwidths, with a feedforward that is 1/G of slow motions."""
    values = problem.values
    slow, shape = reciprocal(box, SLOW), reciprocal(box, QUICK)
    if slow is None or shape is None:
        return []
    # Voltage over velocity [s] that is nearest to Coulomb friction, on the motion where it is least.
    rates = [np.gradient(motion.wanted, problem.period) for motion in problem.motions]
    moved = [float(np.mean(np.abs(v)) / np.mean(v * v)) for v in rates if np.any(v)]
    viscous = float(np.median(box.coulomb)) * min(moved, default=0.0)
    made = []
    for cutoff, (stiff, damped, left) in itertools.product(CUTOFFS, SHAPES):
        formed = shape._replace(c0=stiff * shape.c0, c1=shape.c1 + damped * viscous)
        try:
            highest = cutoff / _tightest(law, values, formed, MOST_CUTOFF, box) / (2.0 * math.pi)
            filtered = left * _tightest(law, values, formed, highest, box)
            loop = _loop(law, values, formed, filtered, highest)
            for part in FED:
                fed = slow._replace(c1=slow.c1 + part * viscous)
                made.append(_fed(law, loop, fed, filtered / stiff, part, problem))
        except ParameterError:
            continue
    return made


def _loop(law: Law, values: Values, shape: Reciprocal, filtered: float, cutoff: float) -> Values:
    """``values`` of ``law`` with λ ``filtered`` [s], and the ``cutoff`` [Hz] within its range."""
    assert law.inverse is not None
    within = min(MOST_CUTOFF, max(LEAST_CUTOFF, cutoff))
    return updated(CONTROLLER, values, law.inverse(values, shape, filtered, within))


def _tightest(law: Law, values: Values, shape: Reciprocal, cutoff: float, box: margins.Box) -> float:
    """λ [s] with which the loop of one valve of the ``box`` is at the edge of stability.

    All gains go with 1/λ, so that it follows from the gain margin with any λ. Raises ParameterError.
    """
    loose = LOOSE * shape.c1 / shape.c0
    params = law.build(_loop(law, values, shape, loose, cutoff))
    left = float(np.min(margins.margins(law, params, box).gain_db))
    if not 0.0 < left < math.inf:
        raise ParameterError("the loop has no gain at which it becomes unstable")
    return loose / float(10.0 ** (left / 20.0))


def _fed(
    law: Law, values: Values, slow: Reciprocal, filtered: float, part: float, problem: Problem
) -> Values:
    """``values`` of a loop with λ ``filtered`` [s], with a feedforward and the lead of the command.

    With a static feedforward of a ``part`` x of c0 a loop without reshaping is late by (1 - x)·λ on a ramp.
    For one that follows a reference the lead makes up for the lag of the reference filter. Raises
    ParameterError.
    """
    made = updated(CONTROLLER, values, law.feedforward(values, slow, part))
    if problem.preview:
        return made
    lead = (1.0 - part) * filtered
    if law.reshapes(law.build(problem.values)):
        highest = reshaping.frequency(values, problem.scale).high
        made = updated(CONTROLLER, made, {"reshaping.natural_frequency": REFERENCE * highest})
        lead = reshaping.lag(made)
    return updated(CONTROLLER, made, {"reshaping.lead": lead, "reshaping.lead_accel": 1.0})


def _shaped(law: Law, problem: Problem) -> list[Values]:
    """The starts that ``law`` has itself, each with a few reference filters and a lead for their lag."""
    values, made = problem.values, []
    highest = reshaping.frequency(values, problem.scale).high
    shares = (1.0,) if problem.preview else SHARES
    for gains, share in itertools.product(law.starts(values, problem.scale), shares):
        try:
            changed = updated(CONTROLLER, values, gains)
            if not problem.preview:
                filtered: Values = {
                    "reshaping.natural_frequency": share * highest,
                    "reshaping.lead_accel": 1.0,
                }
                changed = updated(CONTROLLER, changed, filtered)
                lead = min(law.lag(changed), reshaping.MOST_LEAD)
                changed = updated(CONTROLLER, changed, {"reshaping.lead": lead})
            law.build(changed)
        except ParameterError:
            continue
        made.append(changed)
    return made
