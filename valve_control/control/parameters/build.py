# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Builds the immutable parameters of laws, valve and command shape from checked values.

A controller needs laws alone, so plants and commands are imported where they are built.
"""

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.laws.registry import LAWS
from valve_control.parameter import ParameterError, Values, number, word

if TYPE_CHECKING:
    from valve_control.control.commands.scenarios import Shape
    from valve_control.control.plant.transfer_functions import TransferFunction

OF_A_RUN = 9  # numbers of a sample: three signals, command, with its lead, noise, errors, limit cycle


def law_params(values: Values, accepted: Values | None = None) -> Any:
    """Params of the law that ``controller`` names.

    Every other law is built too, so that a set that could not be switched to is refused at once; but not one
    for which nothing has changed since ``accepted``, values that were built before. Raises ParameterError.
    """
    chosen = word(values, "controller")
    # The part before the dot is a law's name in its own parameters, which no other law reads.
    changed = {name.partition(".")[0] for name in values if (accepted or {}).get(name) != values[name]}
    return {
        name: law.build(values)
        for name, law in LAWS.items()
        if name == chosen or not changed <= LAWS.keys() - {name}
    }[chosen]


def valve_model(values: Values) -> "TransferFunction":
    """Linear model of the valve, with its gain scaled. Raises ParameterError."""
    from valve_control.control.plant import registry

    return registry.chosen(values).model(values)


def valve_params(values: Values) -> Any:
    """Params of the plant that the simulator's parameter `valve` names. Raises ParameterError."""
    from valve_control.control.plant import registry

    return registry.chosen(values).build(values)


def shape(values: Values) -> "Shape":
    """Command shape from the command source's values. Raises ParameterError."""
    from valve_control.control.commands.scenarios import Shape, steps_of, stroke_time

    made = Shape(
        scenario=word(values, "scenario"),
        amplitude=number(values, "amplitude"),
        offset=number(values, "offset"),
        start=number(values, "start"),
        frequency=number(values, "frequency"),
        end_frequency=number(values, "end_frequency"),
        max_velocity=number(values, "max_velocity"),
        max_accel=number(values, "max_accel"),
        cycle=number(values, "cycle"),
        sweep_time=number(values, "sweep_time"),
        steps=int(number(values, "steps")),
        cycles=int(number(values, "cycles")),
        step_time=number(values, "step_time"),
    )
    if made.scenario == "stepped_sine":
        needed = made.start + steps_of(made)[-1].end
        if needed > number(values, "duration") + number(values, "sample_period"):
            raise ParameterError(
                f"duration is {number(values, 'duration'):g} s; the stepped sine takes {needed + 5e-4:.3f} s"
            )
    if made.scenario == "point_to_point":
        ramp, cruise, _ = stroke_time(abs(made.amplitude), made.max_velocity, made.max_accel)
        needed = 2.0 * (2.0 * ramp + cruise)
        if needed > made.cycle:
            raise ParameterError(
                f"cycle is {made.cycle:g} s; a stroke of {made.amplitude:g} V there and back takes "
                f"{needed:.3g} s"
            )
    return made


def check_memory(samples: float, numbers: int = OF_A_RUN) -> None:
    """Raise ParameterError if a run of which ``numbers`` a sample are kept is too large for the machine."""
    need, have = 8.0 * samples * numbers, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if need > have:
        raise ParameterError(
            f"a run of {samples:.0f} samples takes {need / 1e9:.0f} GB of memory and this machine has "
            f"{have / 1e9:.0f} GB; shorten the duration or lengthen sample_period"
        )


def commands(values: Values) -> Floats:
    """Command [V] of each sample from the command source's values. Raises ParameterError."""
    from valve_control.control.commands import arrays

    period = number(values, "sample_period")
    n = max(1, round(number(values, "duration") / period))
    arrays.refuse_aliased(highest_frequency(values), period)
    if values["scenario"] == "array":
        array = arrays.read(word(values, "command_file"))
        return np.concatenate([array[:n], np.full(max(0, n - len(array)), array[-1])])
    return arrays.sampled(shape(values), period, n)


def highest_frequency(values: Values) -> float:
    """Highest frequency [Hz] of the command source's shape, 0 for a shape that has none."""
    scenario = word(values, "scenario")
    if scenario in ("sweep", "stepped_sine"):
        return max(number(values, "frequency"), number(values, "end_frequency"))
    return number(values, "frequency") if scenario in ("sine", "triangle") else 0.0


def derivatives(commands: Floats, period: float) -> tuple[Floats, Floats]:
    """Rates [V/s] and accelerations [V/s²] of ``commands`` [V], by central differences, at rest at ends."""
    padded = np.concatenate([commands[:1], commands, commands[-1:]])
    rates = (padded[2:] - padded[:-2]) / (2.0 * period)
    return rates, (padded[2:] - 2.0 * commands + padded[:-2]) / (period * period)
