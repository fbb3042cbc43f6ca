# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Says what is wanted of a commissioning, and whether that fits the controller."""

from typing import NamedTuple

from valve_control.control.laws import linearisation
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.commissioning.bench import SafetyLimits
from valve_control.parameter import ParameterError, Values, number, updated

SILENCE = 0.5  # s  of the command, after which the controller leads to neutral


class Plan(NamedTuple):
    """What is wanted of a commissioning."""

    limits: SafetyLimits
    law: str
    chatter: float  # limit of c_u
    budget: int  # sets of gains
    valves: int  # that are simulated in the search
    unseen: int  # on which gains are verified
    seed: int
    threads: int
    firm: bool = True  # False: where no gains keep the limit of c_u, the quieter ones are taken
    sensor_delay: float = 0.0  # s  what of the dead time is the sensor's
    alone: bool = False  # no PID is tuned beside the law
    gives_way: bool = False  # whether searches run only while no other wants the core


def limiting(before: Values, limits: SafetyLimits) -> Values:
    """What keeps the ``limits`` on the controller, while the voltage is commanded."""
    timeout = number(before, "command_timeout")
    return {
        "controller": "open_loop",
        "open_loop.static_gain": 1.0,
        "u_max": limits.voltage,
        "command_limit": limits.voltage,
        "command_timeout": SILENCE if timeout == 0.0 else min(timeout, SILENCE),
        "command.bridge": 0.0,
        "command.lag": 0.0,
        "reshaping.lead": 0.0,
    }


def check(plan: Plan, values: Values) -> None:
    """Raise ParameterError unless ``plan`` fits a controller with these ``values``."""
    u_max, lvdt_limit = number(values, "u_max"), number(values, "lvdt.limit")
    if not 0.1 <= plan.limits.voltage <= u_max:
        raise ParameterError(
            f"--max-voltage is {plan.limits.voltage:g} V; it must lie between 0.1 V and u_max, {u_max:g} V"
        )
    if not 0.2 <= plan.limits.travel <= min(lvdt_limit, number(values, "command_limit")):
        most = min(lvdt_limit, number(values, "command_limit"))
        raise ParameterError(
            f"--travel is {plan.limits.travel:g} V; it must lie between 0.2 V and the smaller of lvdt.limit "
            f"and command_limit, {most:g} V"
        )
    if values["lockstep"]:
        raise ParameterError("the controller runs in lockstep; a valve is commissioned on the wall clock")
    if linearisation.is_on(values):
        raise ParameterError(
            "linearisation.enabled is true; a valve is commissioned with its own static curve: set it to "
            "false, and to true again with the new gains"
        )
    if not LAWS[plan.law].free:
        raise ParameterError(f"{plan.law} has no gains to choose; there is nothing to tune")
    updated(CONTROLLER, values, limiting(values, plan.limits))
