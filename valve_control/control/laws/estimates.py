# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists and reads the parameters of laws that estimate the valve: initial estimates, ranges (5), rates."""

from typing import Any

from valve_control.control.laws import reshaping
from valve_control.control.laws.free import Free
from valve_control.control.laws.projection import Theta
from valve_control.parameter import Parameter, ParameterError, Table, Values, number, numbers

NAMES = ("a1", "a0", "b0", "b0·dn")
UNITS = "[a1 1/s, a0 1/s², b0 1/s², b0·dn V/s²]"
INITIAL = [20.0, 1200.0, 1200.0, 0.0]
LOWEST = [5.0, 500.0, 900.0, -6000.0]
HIGHEST = [150.0, 3000.0, 2500.0, 6000.0]


def parameters(law: str, gamma: list[float]) -> Table:
    """Rows of the parameter table for ``law``; ``gamma``: default of the adaptation rates."""
    return (
        Parameter(f"{law}.gamma", gamma, "", "diagonal of the rate matrix Γ of (15)", 0.0, 1e12, length=4),
        *(
            Parameter(f"{law}.theta_{name}", usual, "", f"{text}: {UNITS}", -1e9, 1e9, length=4)
            for name, usual, text in (
                ("initial", INITIAL, "initial estimates θ̂(0), setting which restarts them"),
                ("min", LOWEST, "lower bounds of θ, (5)"),
                ("max", HIGHEST, "upper bounds of θ, (5)"),
            )
        ),
        Parameter(
            f"{law}.robust_term",
            "none",
            "",
            "robust term: none, or the smooth quadratic one that satisfies (23), (42), (50)",
            choices=("none", "quadratic"),
        ),
    )


def free(law: str) -> tuple[Free, ...]:
    """Adaptation rates of ``law``, as numbers that a tuner may choose."""
    ranges = ((0.01, 100.0), (1.0, 1e4), (1.0, 1e4), (100.0, 1e6))
    return tuple(Free(f"{law}.gamma[{i}]", low, high) for i, (low, high) in enumerate(ranges))


def bounds(values: Values, law: str) -> tuple[Theta, Theta, Theta]:
    """Initial estimates, lower and upper bounds. Raises ParameterError."""
    lower = numbers(values, f"{law}.theta_min")
    start = numbers(values, f"{law}.theta_initial")
    upper = numbers(values, f"{law}.theta_max")
    for i, name in enumerate(NAMES):
        if lower[i] > upper[i]:
            raise ParameterError(
                f"{law}.theta_min[{i}] ({name}) is {lower[i]:g}, above {law}.theta_max[{i}], {upper[i]:g}"
            )
        if not lower[i] <= start[i] <= upper[i]:
            raise ParameterError(
                f"{law}.theta_initial[{i}] ({name}) is {start[i]:g}; it must lie between "
                f"{law}.theta_min[{i}], {lower[i]:g}, and {law}.theta_max[{i}], {upper[i]:g}"
            )
    if lower[2] <= 0.0:
        raise ParameterError(
            f"{law}.theta_min[2] (b0) is {lower[2]:g}; it must be positive, since the law divides by b0"
        )
    return Theta(*start), Theta(*lower), Theta(*upper)


def params(values: Values, law: str) -> dict[str, Any]:
    """Fields that the Params of ARC and OARC share; ``robust`` is 1.0 with the quadratic robust term.

    Raises ParameterError.
    """
    start, lower, upper = bounds(values, law)
    return {
        "gamma": Theta(*numbers(values, f"{law}.gamma")),
        "theta_initial": start,
        "theta_min": lower,
        "theta_max": upper,
        "robust": 1.0 if values[f"{law}.robust_term"] == "quadratic" else 0.0,
        "disturbance_bound": number(values, f"{law}.disturbance_bound"),
        "u_max": number(values, "u_max"),
        "period": number(values, "sample_period"),
        "reshaping": reshaping.build(values),
    }


def model(p: Any) -> tuple[float, float, float]:
    """a1, a0 and b0 of the initial estimates of a law with the Params ``p``."""
    return p.theta_initial.a1, p.theta_initial.a0, p.theta_initial.b0


def at_rest(p: Any, s: Any) -> tuple[Any, Any]:
    """Params and state of a law with its estimates at rest, for which its step is linear."""
    return p._replace(gamma=Theta(0.0, 0.0, 0.0, 0.0)), s
