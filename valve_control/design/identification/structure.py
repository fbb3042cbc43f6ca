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

from valve_control.design.identification.rational import Fit, check_clear, check_worth, criterion, fit
from valve_control.design.identification.response import Response
from valve_control.parameter import ParameterError

FORMS = ((2, 0), (3, 0), (3, 1), (4, 1), (4, 2))  # poles and zeros
NEAR = 6.0  # of the criterion, within which the simplest candidate counts


class Candidate(NamedTuple):
    """One structure of a model."""

    poles: int
    zeros: int
    late: bool  # with a dead time

    @property
    def unknowns(self) -> int:
        """Coefficients and dead time."""
        return self.poles + self.zeros + 1 + self.late


class Scored(NamedTuple):
    """A candidate and what the response says of it."""

    form: Candidate
    criterion: float  # BIC, less is better
    model_error: float  # relative error that noise does not explain


def candidates(delayed: bool | None) -> list[Candidate]:
    """All candidates, the simplest first; ``delayed``: without or with a dead time, None: both."""
    late = (False, True) if delayed is None else (delayed,)
    return sorted((Candidate(*form, d) for form in FORMS for d in late), key=lambda c: c.unknowns)


def choose(measured: Response, delayed: bool | None = None) -> Fit:
    """The simplest of the candidates nearest to ``measured``; ``delayed`` as for ``candidates``.

    Candidates with more unknowns are tried until noise alone explains what one leaves. One whose
    coefficients are not in the data gives way to the next best. Raises ParameterError if none is left.
    """
    tried: list[Scored] = []
    refusals: list[str] = []
    for _, level in groupby(candidates(delayed), key=lambda c: c.unknowns):
        for form in level:
            try:
                tried.append(Scored(form, *criterion(measured, *form)))
            except ParameterError as error:
                refusals.append(str(error))
        if any(one.model_error == 0.0 for one in tried):
            break
    while tried:
        best = simplest(tried)
        tried.remove(best)
        try:
            fitted = fit(measured, best.form.poles, best.form.zeros, best.form.late)
            check_worth(fitted)
            if fitted.order > 2:
                check_clear(fitted)
            return fitted
        except ParameterError as error:
            refusals.append(str(error))
    raise ParameterError(refusals[0])


def simplest(tried: list[Scored]) -> Scored:
    """Of the nearest: fewest zeros, then fewest poles, then no dead time.

    Near are those within NEAR of the least criterion, and those that leave no more than noise.
    """
    least = min(one.criterion for one in tried)
    near = [one for one in tried if one.criterion <= least + NEAR or one.model_error == 0.0]
    return min(near, key=lambda one: (one.form.zeros, one.form.poles, one.form.late))


def beside(measured: Response, second: Fit, delayed: bool = False) -> tuple[Fit | None, str]:
    """The model that stands for the valve beside the ``second`` order, or None and why there is none.

    ``delayed``: it has a dead time in any case. Raises ParameterError if nothing can be fitted.
    """
    if second.model_error == 0.0:
        return None, "noise alone explains what the second order leaves, so no higher order is fitted"
    best = choose(measured, True if delayed else None)
    if best.names != second.names:
        return best, ""
    return None, "the second order stands alone: more poles explain no more of the response than chance does"
