# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the cost of a calibration: how far simulated indices are from the measured table."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from research.calibration.space import Settings
from valve_control.arrays import Floats
from valve_control.control import closed_loop
from valve_control.control.analysis.indices import Indices, indices
from valve_control.control.commands import scenarios
from valve_control.control.compiling import compile_function
from valve_control.control.laws import command_lead, linearisation
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES
from valve_control.control.plant import registry
from valve_control.parameter import number, updated

Table = Mapping[str, Indices]  # by controller; NaN where nothing was measured
WITHIN, BEYOND = 0.045, 1.0  # log ratio beyond which a number counts by itself, and how much
ORDER, GAP = 0.003, 1.0  # cost of two controllers in the wrong order, and of the log ratio by which they are
FAILED = 10.0  # cost of a valve that cannot be run
NO_TERMS = np.zeros((0, 0))


class Fit(NamedTuple):
    """How near a table of simulated indices is to the measured one."""

    rms: float  # root mean square of the log ratios
    worst: float  # largest of them
    orderings: int  # pairs of controllers that an index puts in the other order than the table
    gap: float  # sum of the log ratios by which it does

    @property
    def cost(self) -> float:
        """Cost that a search minimises; errors beyond WITHIN and wrong orders cost extra."""
        return self.rms + BEYOND * max(0.0, self.worst - WITHIN) + ORDER * self.orderings + GAP * self.gap


NOT_RUN = Fit(FAILED, FAILED, 0, 0.0)


def sampled_strokes(shape: scenarios.Shape, period: float, commands: Floats) -> None:
    """Point-to-point commands [V], one every ``period`` [s]."""
    for k in range(commands.shape[0]):
        t = k * period - shape.start
        value = shape.offset
        if t >= 0.0:
            value += scenarios.there_and_back(shape, t)
        commands[k] = value


def commands_of(settings: Settings) -> Floats:
    """Command [V] of each sample; compiled where a search varies it."""
    values = settings["command_source"]
    if values["scenario"] != "point_to_point":
        return build.commands(values)
    period = number(values, "sample_period")
    commands = np.zeros(max(1, round(number(values, "duration") / period)))
    compile_function(sampled_strokes)(build.shape(values), period, commands)
    return commands


def run(settings: Settings, controllers: Sequence[str], seeds: Sequence[int]) -> dict[str, list[Indices]]:
    """Indices of each controller with each seed of the LVDT's noise. Raises ParameterError."""
    command = commands_of(settings)
    valve_params = build.valve_params(settings["valve_simulator"])
    plant = registry.plant_of(valve_params).module
    noises = [np.random.default_rng(seed).standard_normal(len(command)) for seed in seeds]
    signals = np.zeros((len(command), len(closed_loop.SIGNALS)))
    found: dict[str, list[Indices]] = {name: [] for name in controllers}
    for name in controllers:
        values = updated(NODES["controller"], settings["controller"], {"controller": name})
        law_params = LAWS[name].build(values)
        led = command_lead.applied(command_lead.build(values, LAWS[name].reshapes(law_params)), command)
        loop_params = linearisation.behind(values, law_params)
        law = linearisation.module_of(LAWS[name].module, loop_params)
        given = closed_loop.parts(loop_params, valve_params)
        for noise in noises:
            state = plant.initial(valve_params)
            first = plant.read(valve_params, state, noise[0])
            begun = law.initial(loop_params, Start(first, 0.0, first, 0.0, 0.0))
            begin = closed_loop.parts(begun, state)
            closed_loop.run_valve(law, given, begin, led, noise, signals, NO_TERMS)
            found[name].append(indices(signals[:, 1] - command, signals[:, 2], valve_params.period))
    return found


def log_ratios(found: Mapping[str, Sequence[Indices]], table: Table) -> dict[str, Floats]:
    """log(index/table), the mean over seeds, by controller; NaN where the table has nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return {
            name: np.mean(np.log(np.array(runs, dtype=float)), axis=0) - np.log(np.array(table[name]))
            for name, runs in found.items()
        }


def swapped(found: Mapping[str, Sequence[Indices]], table: Table) -> dict[tuple[str, str, str], float]:
    """(index, better, worse) of the table for each pair that the means over seeds order otherwise.

    With each the log ratio by which the better one is above.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        means = {name: np.mean(np.log(np.array(runs, dtype=float)), axis=0) for name, runs in found.items()}
    pairs = {}
    for i, index in enumerate(Indices._fields):
        for better in table:
            for worse in table:
                gap = float(means[better][i] - means[worse][i])
                if table[better][i] < table[worse][i] and not gap < 0.0:
                    pairs[index, better, worse] = gap
    return pairs


def fit(found: Mapping[str, Sequence[Indices]], table: Table) -> Fit:
    """Compare ``found`` with ``table``."""
    measured = ~np.isnan(np.concatenate([np.array(table[name]) for name in found]))
    ratios = np.concatenate(list(log_ratios(found, table).values()))[measured]
    if not np.all(np.isfinite(ratios)):
        return NOT_RUN
    pairs = swapped(found, table)
    return Fit(
        float(np.sqrt(np.mean(ratios**2))), float(np.max(np.abs(ratios))), len(pairs), sum(pairs.values())
    )
