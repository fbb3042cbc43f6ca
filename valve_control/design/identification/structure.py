# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Chooses poles, zeros and dead time of a valve's model by what its response shows.

Each candidate is fitted by maximum likelihood. Its error at a frequency has the variance of the measurement
and of a relative error of the model, which is the least that explains the residual. Schwarz's criterion [1]
(BIC) weighs the likelihood against the number of unknowns. Of candidates that are nearly as good, or that
leave nothing but noise, the simplest counts: a coil is a pole without a zero, and a dead time has to show
itself beside it.

[1] G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6 (1978).
"""

from itertools import groupby

from valve_control.design.identification.rational import Fit, check_worth, fit, is_clear
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError

FORMS = ((2, 0), (3, 0), (3, 1), (4, 1), (4, 2))  # poles and zeros
NEAR = 6.0  # of the criterion, within which the simplest candidate counts


def choose(measured: Response, delayed: bool = False, order: int | None = None) -> Fit:
    """The simplest of the candidates nearest to ``measured``; ``delayed``: with a dead time in any case.

    With an ``order`` only the dead time is chosen; there are two more poles than zeros then. Candidates with
    more unknowns are tried until noise alone explains what one leaves. One whose coefficients are not in the
    data gives way to the next best. Raises ParameterError if none is left.
    """
    shapes = FORMS if order is None else ((order, order - 2),)
    forms = [(*shape, late) for shape in shapes for late in ((True,) if delayed else (False, True))]
    tried: list[tuple[tuple[int, int, bool], Fit]] = []
    refusals: list[ParameterError] = []
    for _, level in groupby(sorted(forms, key=sum), key=sum):  # the number of unknowns, less 1
        for poles, zeros, late in level:
            try:
                tried.append(((zeros, poles, late), fit(measured, poles, zeros, late)))
            except ParameterError as error:
                refusals.append(error)
        if any(one.model_error == 0.0 for _, one in tried):
            break
    while tried:
        # Of the nearest: fewest zeros, then fewest poles, then no dead time.
        least = min(one.criterion for _, one in tried)
        near = [one for one in tried if one[1].criterion <= least + NEAR or one[1].model_error == 0.0]
        best = min(near, key=lambda one: one[0])
        tried = [one for one in tried if one is not best]
        try:
            check_worth(best[1])
            if order is not None or is_clear(best[1]):
                return best[1]
        except ParameterError as error:
            refusals.append(error)
    raise refusals[0]
