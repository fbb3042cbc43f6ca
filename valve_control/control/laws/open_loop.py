# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Divides the command by the valve's static gain: what a valve does without any local controller."""

from valve_control.control.laws import biquads
from valve_control.control.laws.law import Law
from valve_control.parameter import Parameter, Table, Values, number

PARAMETERS: Table = (
    Parameter(
        "open_loop.static_gain",
        46882988.0 / 56553725.0,
        "V/V",
        "static gain of the valve; default: that of (3)",
        1e-6,
        1e6,
    ),
)


def build(values: Values) -> biquads.Params:
    """Params of the static gain from the controller's values."""
    return biquads.static_params(number(values, "open_loop.static_gain"), number(values, "u_max"))


LAW = Law(
    name="open_loop",
    text="the command over the valve's static gain",
    module=biquads,
    parameters=PARAMETERS,
    build=build,
    reshapes=lambda params: False,  # the command is followed as it comes
    steady_command=biquads.steady_command,
)
