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
from typing import NamedTuple

from valve_control.design.identification.rational import Fit, check_worth, criterion, fit, is_clear
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError

FORMS = ((2, 0), (3, 0), (3, 1), (4, 1), (4, 2))  # poles and zeros
NEAR = 6.0  # of the criterion, within which the simplest candidate counts


class Candidate(NamedTuple):
    """One structure of a model, and what the response says of it."""

    poles: int
    zeros: int
    late: bool  # with a dead time
    criterion: float  # BIC, less is better
    model_error: float  # relative error that noise does not explain


def choose(measured: Response, delayed: bool = False) -> Fit:
    """The simplest of the candidates nearest to ``measured``; ``delayed``: with a dead time in any case.

    Candidates with more unknowns are tried until noise alone explains what one leaves. One whose
    coefficients are not in the data gives way to the next best. Raises ParameterError if none is left.
    """
    forms = [(*form, late) for form in FORMS for late in ((True,) if delayed else (False, True))]
    tried: list[Candidate] = []
    refusals: list[ParameterError] = []
    for _, level in groupby(sorted(forms, key=sum), key=sum):  # the number of unknowns, less 1
        for poles, zeros, late in level:
            try:
                tried.append(Candidate(poles, zeros, late, *criterion(measured, poles, zeros, late)))
            except ParameterError as error:
                refusals.append(error)
        if any(one.model_error == 0.0 for one in tried):
            break
    while tried:
        # Of the nearest: fewest zeros, then fewest poles, then no dead time.
        least = min(one.criterion for one in tried)
        near = [one for one in tried if one.criterion <= least + NEAR or one.model_error == 0.0]
        best = min(near, key=lambda one: (one.zeros, one.poles, one.late))
        tried.remove(best)
        try:
            fitted = fit(measured, best.poles, best.zeros, best.late)
            check_worth(fitted)
            if is_clear(fitted):
                return fitted
        except ParameterError as error:
            refusals.append(error)
    raise refusals[0]
