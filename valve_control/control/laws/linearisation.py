# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Puts the inverse of a valve's static curve between a law and the amplifier (docs/howto/linearise.md).

The static curve x = f(u) has two gains, an overlap or underlap, a null and stops. A law gives the voltage v,
the amplifier gets u = f⁻¹(G·v) with the static gain G of the law's model: law, observer and watches then see
a valve of one gain. The curve and its inverse are straight between given points and go on straight
beyond them.
"""

import types
from collections import namedtuple
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple, get_type_hints

from valve_control.control.compiling import bind
from valve_control.control.laws.places import law_hold, law_initial, law_step
from valve_control.control.laws.signals import Start
from valve_control.parameter import Parameter, ParameterError, Table, Values, number, numbers

ROUNDING = 1e-9  # of the limit, which the inverse then cannot exceed
MOST = 32  # points
FLATTEST = 1e-3  # of the gain, slope of the curve between two points
NEVER = 1e30  # V  where no segment begins
POINTS = ("linearisation.voltage", "linearisation.position")

PARAMETERS: Table = (
    Parameter(
        "linearisation.enabled",
        False,
        "",
        "put the inverse of the valve's static curve between the law and the amplifier; the curve can be "
        "changed while this is false and is checked when it becomes true",
    ),
    Parameter(
        "linearisation.voltage", [-10.0, 10.0], "V", f"curve: rising voltages, 2 to {MOST}", -100.0, 100.0
    ),
    Parameter(
        "linearisation.position", [-10.0, 10.0], "V", "curve: steady positions at these", -100.0, 100.0
    ),
    Parameter("linearisation.gain", 1.0, "V/V", "static gain of the law's model", 1e-3, 1e3),
)


class Segment(NamedTuple):
    """A straight line, up to where the next one begins."""

    begin: float  # V
    value: float  # V  there
    slope: float  # V/V


class Eight(NamedTuple):
    """Eight lines, of which the last ones may begin NEVER."""

    a: Segment
    b: Segment
    c: Segment
    d: Segment
    e: Segment
    f: Segment
    g: Segment
    h: Segment


class Curve(NamedTuple):
    """Lines one after the other; the first one has no beginning."""

    first: Eight
    second: Eight
    third: Eight
    fourth: Eight


def along(line: Segment, at: float) -> float:
    """Value [V] of the ``line`` ``at`` [V]."""
    return line.value + line.slope * (at - line.begin)


def within(part: Eight, at: float) -> float:
    """Value [V] of a ``part`` of a curve ``at`` [V]."""
    if at > part.e.begin:
        if at > part.g.begin:
            return along(part.h, at) if at > part.h.begin else along(part.g, at)
        return along(part.f, at) if at > part.f.begin else along(part.e, at)
    if at > part.c.begin:
        return along(part.d, at) if at > part.d.begin else along(part.c, at)
    return along(part.b, at) if at > part.b.begin else along(part.a, at)


def value(curve: Curve, at: float) -> float:
    """Value [V] of the ``curve`` ``at`` [V]."""
    if at > curve.third.a.begin:
        return within(curve.fourth, at) if at > curve.fourth.a.begin else within(curve.third, at)
    return within(curve.second, at) if at > curve.second.a.begin else within(curve.first, at)


# From parameters


def _curve(at: Sequence[float], values: Sequence[float]) -> Curve:
    """Straight lines through ``values`` [V] ``at`` [V]."""
    lines = [
        Segment(x, y, (after - y) / (end - x))
        for (x, end), (y, after) in zip(pairwise(at), pairwise(values), strict=True)
    ]
    lines += [Segment(NEVER, 0.0, 0.0)] * (MOST - len(lines))
    return Curve(*(Eight(*lines[i : i + 8]) for i in range(0, MOST, 8)))


def _points(values: Values) -> tuple[Sequence[float], Sequence[float]]:
    """Voltages of amplifier [V] and law [V] at the points. Raises ParameterError."""
    voltage, position = (numbers(values, name) for name in POINTS)
    gain = number(values, "linearisation.gain")
    if len(voltage) != len(position):
        raise ParameterError(
            f"linearisation.voltage has {len(voltage)} points and linearisation.position {len(position)}; "
            "they must have as many"
        )
    if not 2 <= len(voltage) <= MOST:
        raise ParameterError(
            f"linearisation.voltage has {len(voltage)} point{'s' * (len(voltage) != 1)}; it must have 2 to "
            f"{MOST}"
        )
    for name, points in zip(POINTS, (voltage, position), strict=True):
        for i, (before, after) in enumerate(pairwise(points)):
            if not before < after:
                raise ParameterError(
                    f"{name}[{i + 1}] is {after:g} V; it must be above {name}[{i}], {before:g} V"
                )
    for i, ((u, end), (x, after)) in enumerate(zip(pairwise(voltage), pairwise(position), strict=True)):
        slope = (after - x) / (end - u)
        if not FLATTEST * gain <= slope <= gain / FLATTEST:
            raise ParameterError(
                f"the curve of linearisation.position rises by {slope:.3g} V/V behind point {i}; it must be "
                f"between {FLATTEST * gain:g} and {gain / FLATTEST:g} V/V, since linearisation.gain is "
                f"{gain:g}"
            )
    return voltage, [x / gain for x in position]


def is_on(values: Values) -> bool:
    """Whether there is a curve in use."""
    return values.get("linearisation.enabled") is True


def inverse(values: Values) -> Curve:
    """Voltage of the amplifier over that of the law. Raises ParameterError."""
    voltage, wanted = _points(values)
    return _curve(wanted, voltage)


def forward(values: Values) -> Curve:
    """Voltage of the law over that of the amplifier. Raises ParameterError."""
    return _curve(*_points(values))


def seen(values: Values) -> Values:
    """``values`` as law and watches get them: ``u_max`` is the limit of the law's voltage.

    That is the smaller one of both sides: a law has one limit, and what it gives the amplifier must give.
    Raises ParameterError.
    """
    if not is_on(values):
        return values
    curve, u_max = forward(values), number(values, "u_max")
    limit = (1.0 - ROUNDING) * min(value(curve, u_max), -value(curve, -u_max))
    if not limit > 0.0:
        raise ParameterError(
            f"the curve of linearisation.position does not pass 0 V between -{u_max:g} and {u_max:g} V, the "
            "limits u_max of the amplifier"
        )
    null = value(curve, 0.0)
    if not abs(null) < limit:
        raise ParameterError(
            f"the curve of linearisation.position gives the law {null:g} V at 0 V of the amplifier; it must "
            f"be less than {limit:g} V, which the amplifier reaches on both sides within u_max"
        )
    return {**values, "u_max": limit}


def built(build: Callable[[Values], Any], values: Values) -> Any:
    """Params of a law by its ``build``, within the limit of its voltage. Raises ParameterError."""
    return build(seen(values))


def given(values: Values, voltage: float) -> float:
    """Voltage [V] of the law for one of the amplifier [V]. Raises ParameterError."""
    return value(forward(values), voltage) if is_on(values) else voltage


# A law with the curve behind it, for simulations and exported C


class Params(NamedTuple):
    """A law and the curve behind it."""

    law: Any  # Params of the law
    inverse: Curve
    forward: Curve
    u_max: float  # V  of the amplifier
    period: float  # s


def initial(p: Params, start: Start) -> Any:
    """State of the law at ``start``, whose voltage is that of the amplifier."""
    voltage = value(p.forward, start.voltage)
    return law_initial(
        p.law, Start(start.measurement, voltage, start.reference, start.reference_rate, start.velocity)
    )


def step(p: Params, s: Any, command: float, measurement: float, offset: float) -> Any:
    """Step of the law; the voltage [V] is the amplifier's, the terms and ``offset`` [V] are the law's."""
    voltage, state, terms = law_step(p.law, s, command, measurement, offset)
    return value(p.inverse, voltage), state, terms


def hold(p: Params, s: Any, command: float, measurement: float, voltage: float) -> Any:
    """State of the law after a sample without a reading, with ``voltage`` [V] of the amplifier."""
    return law_hold(p.law, s, command, measurement, value(p.forward, voltage))


def behind(values: Values, law: Any) -> Any:
    """Params of a loop with the ``law``'s Params: with the curve behind it, or those of the law alone.

    Raises ParameterError.
    """
    if not is_on(values):
        return law
    u_max, period = (number(values, name) for name in ("u_max", "sample_period"))
    return Params(law, inverse(values), forward(values), u_max, period)


def module_of(module: types.ModuleType, params: Any) -> types.ModuleType:
    """Steps of a law's ``module`` for what ``behind`` made."""
    return around(module) if isinstance(params, Params) else module


def around(module: types.ModuleType) -> types.ModuleType:
    """Steps of a law's ``module`` with the curve behind it."""
    return _around(module, Params, module.step)


def exported(module: types.ModuleType) -> types.ModuleType:
    """The same, with Params that name those of the law, as C needs them."""
    hints = {**get_type_hints(Params), "law": module.Params}
    params: Any = namedtuple("Params", list(hints))  # type: ignore[misc]  # noqa: PYI024
    params.__annotations__, params.__module__ = hints, __name__
    setattr(params, "template", Params)  # noqa: B010  # with the comments of the fields
    made = _around(module, params, module.step)
    for function in (made.initial, made.step, made.hold):
        function.__annotations__["p"] = params
    return made


@cache
def _around(module: types.ModuleType, params: Any, step_of_law: Any) -> types.ModuleType:
    made = types.ModuleType(module.__name__)
    places = {"law_initial": module.initial, "law_step": step_of_law, "law_hold": module.hold}
    vars(made).update(bind({"initial": initial, "step": step, "hold": hold}, places))
    vars(made).update(Params=params, State=module.State, Terms=module.Terms)
    return made
