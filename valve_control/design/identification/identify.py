# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Identifies a valve by its tests: response, structure, friction, characteristic curve, first gains."""

from typing import NamedTuple

from valve_control.design.identification import (
    bode_fit,
    characteristic,
    dead_time,
    experiment,
    first_gains,
    friction,
    lvdt,
    theta,
)
from valve_control.design.identification.bode_fit import Fit
from valve_control.design.identification.characteristic import Characteristic
from valve_control.design.identification.experiment import Experiment
from valve_control.design.identification.friction import Friction
from valve_control.design.identification.response import Response
from valve_control.design.identification.result import Identification
from valve_control.parameter import Parameter, ParameterError

SETTLE = 0.4  # s
ROUNDS = 2  # the friction needs the model, and the model the friction


class Request(NamedTuple):
    """How tests are evaluated."""

    settle: float = SETTLE  # s  transient at the beginning of each step that is left out
    band: tuple[float, float] | None = None  # Hz  that is fitted; None: all
    order: int | None = None  # of the model beside the second order; None: the response chooses
    sensor_delay: float = 0.0  # s  part of the dead time

    def check(self) -> None:
        """Raise ParameterError for what cannot be."""
        dead_time.OF_SENSOR.check(self.sensor_delay)
        Parameter("--settle", SETTLE, "s", "", 0.0, 1e6).check(self.settle)
        low, high = self.band or (1.0, 2.0)
        if not 0.0 < low < high < float("inf"):
            raise ParameterError(f"--band {low:g} {high:g} must be two rising frequencies above 0 Hz")


def identified(tested: Experiment, triangle: Experiment | None, request: Request) -> Identification:
    """The valve of the test ``tested``, and of a slow ``triangle`` with its friction.

    The friction needs the lag of the model, and the model what friction leaves. Raises ParameterError.
    """
    if triangle is not None and triangle.period != tested.period:
        raise ParameterError(
            f"the friction test has a sample period of {triangle.period:g} s, the other one of "
            f"{tested.period:g} s; they must agree"
        )
    tested = tested if tested.command is None else experiment.excited(tested)
    whole = measured = experiment.estimate(tested, request.settle, request.band)
    fits = _fits(request.order, measured)
    rubbing, curve = None, None
    for _ in range(0 if triangle is None else ROUNDS):
        assert triangle is not None
        rubbing, curve = characteristic.friction_and_curve(
            triangle, friction.lag_of(fits[-1].model, fits[-1].delay)
        )
        if tested.segments:
            slipping, played = _slipping(tested, rubbing, curve, measured)
            measured = experiment.estimate(slipping, request.settle, request.band)
            measured = friction.unsure(measured, whole) if played else measured
            fits = _fits(request.order, measured)
    return _with_gains(request, tested, measured, fits, rubbing, curve)


def _slipping(
    tested: Experiment, rubbing: Friction, curve: Characteristic | None, measured: Response
) -> tuple[Experiment, bool]:
    """``tested`` without friction, and whether without the play of a magnet that the ``curve`` shows, too.

    The coil of that magnet is a pole of the model without zeros that is nearest to ``measured``.
    """
    apart = first_gains.without_play(rubbing, curve)
    assert apart is not None
    if apart is rubbing or curve is None or curve.shares is None or rubbing.presliding == 0.0:
        return friction.without(tested, rubbing), False  # swings at its turns, or its overlap hides the play
    try:
        magnet = first_gains.magnet_of(bode_fit.fit(measured, 3, 0, True).model, curve)
    except ParameterError:
        magnet = None
    return friction.without(tested, apart, curve.shares.play, 0.0 if magnet is None else magnet.coil), True


def _fits(order: int | None, measured: Response) -> tuple[Fit, ...]:
    """The second order for the estimates, then the model that stands for the valve if it is another.

    The response chooses a dead time, and the form where no ``order`` is asked for. A second order that misses
    it then has a dead time too. Where the test does not tell the bounds of the second order, it tells those
    of an order that is asked for only if the response would choose it.
    """
    refusals: list[ParameterError] = []
    for delayed in (False, True):
        try:
            second = bode_fit.fit(measured, 2, delayed=delayed)
            bode_fit.check_worth(second)
            break
        except ParameterError as error:
            refusals.append(error)
    else:
        raise refusals[0]
    if order is None and second.model_error == 0.0:  # noise alone explains what is left
        return (second,)
    best = bode_fit.choose(measured, order)
    if best.names == second.names:
        return (second,)
    return second, best._replace(bounded=best.bounded and (second.bounded or bode_fit.is_clear(best)))


def _with_gains(
    request: Request,
    tested: Experiment,
    measured: Response,
    fits: tuple[Fit, ...],
    rubbing: Friction | None,
    curve: Characteristic | None,
) -> Identification:
    """The valve with its first gains, and notes on what the tests do not show."""
    second, best = fits[0], fits[-1]
    known = first_gains.KnownValve(
        model=best.model,
        delay=best.delay,
        theta=theta.suggest(measured, second, best, tested.u_max),
        lvdt=lvdt.observe(tested.position),
        period=measured.period,
        u_max=tested.u_max,
        friction=rubbing,
        sensor_delay=request.sensor_delay,
    )
    apart, magnet = first_gains.without_play(rubbing, curve), first_gains.magnet_of(best.model, curve)
    gains = first_gains.first(known._replace(friction=apart, magnet=magnet))
    notes = [
        *tested.notes,
        *measured.notes,
        *experiment.period_notes(measured.period, second.model),
        *dead_time.notes(best.delay, request.sensor_delay),
        *gains.notes,
    ]
    if tested.feedback:
        notes.append(
            f"recorded under feedback ({tested.feedback}): the response is that of position and voltage to "
            "the command, which noise of the reading does not bias"
        )
    if not all(fit.bounded for fit in fits):
        notes.append(
            "no 95 % bounds where fits miss more than noise: a stepped sine or a longer test tells more"
        )
    return Identification(tested.source, known, gains.values, tuple(notes), measured, fits, curve)
