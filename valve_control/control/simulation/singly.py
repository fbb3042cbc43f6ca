# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates one valve of a batch by itself, for plants that have no loop over several valves at once."""

import types
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control import closed_loop
from valve_control.control.compiling import compile_function
from valve_control.control.laws.signals import Start
from valve_control.control.simulation import measures
from valve_control.control.simulation.measures import Tally


class Run(NamedTuple):
    """One valve of a batch."""

    law: types.ModuleType
    law_params: Any
    plant: types.ModuleType
    plant_params: Any
    seed: int  # of the reading's noise
    commands: Floats  # V
    led: Floats  # V  with their lead
    last_begin: int  # sample at which the last two seconds begin


class Known(NamedTuple):
    """What the measures take in besides the loop's own signals."""

    commands: Floats  # V  without their lead
    last_begin: int
    u_max: float  # V
    period: float  # s


class Seen(NamedTuple):
    """What is kept up."""

    samples: int
    time: float  # s
    tally: Tally


def counted(p: Known, seen: Seen, now: closed_loop.Sample, plant: Any) -> tuple[Seen, bool]:
    """Update the measures with this sample."""
    k = seen.samples
    here = measures.Now(
        p.commands[k],
        now.reading,
        plant.x.x0,
        now.voltage,
        k == 0,
        k >= p.last_begin,
        seen.time,
        p.u_max,
        p.period,
    )
    return Seen(k + 1, seen.time + p.period, measures.count(seen.tally, here)), False


@cache
def _compiled(law: types.ModuleType, plant: types.ModuleType) -> Callable[..., Any]:
    functions = {
        "next_command": closed_loop.command_given,
        "read": plant.read,
        "law_step": law.step,
        "measured": compile_function(counted),
        "plant_step": plant.step,
        "shown": closed_loop.valve_signals,
    }
    return closed_loop.build(functions, nogil=True)


def simulate(run: Run, signals: Floats) -> Tally:
    """Tally of one valve; ``signals`` (n×3) receives ``closed_loop.SIGNALS`` [V]."""
    noise = np.random.default_rng(run.seed).standard_normal(len(signals))
    state = run.plant.initial(run.plant_params)
    first = run.plant.read(run.plant_params, state, float(noise[0]))
    begun = run.law.initial(run.law_params, Start(first, 0.0, first, 0.0, 0.0))
    known = Known(run.commands, run.last_begin, run.plant_params.u_max, run.plant_params.period)
    p = closed_loop.Parts(0.0, run.law_params, run.plant_params, known)
    begin = closed_loop.Parts(0.0, begun, state, Seen(0, 0.0, Tally._make([0.0] * len(Tally._fields))))
    loop = _compiled(run.law, run.plant)
    end = loop(p, begin, run.led, noise, signals, np.empty((0, len(run.law.Terms._fields))))
    tally: Tally = end.measure.tally
    return tally
