# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the closed loop sample by sample: reads the plant, takes the command, steps the law, moves the plant.

Command source, law, plant and measures (what is measured in the run) are arguments: functions of the forms
below, which the loop is compiled with, and their parameters and states.
"""

import types
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from valve_control.arrays import Floats
from valve_control.control.compiling import bind, compile_function
from valve_control.control.laws.places import law_step
from valve_control.control.plant import registry

SIGNALS = ("position", "measurement", "voltage")


class Parts(NamedTuple):
    """The parameters, or the states, of all that takes part in a loop; each of a type of its own."""

    source: Any  # of the command
    law: Any
    plant: Any
    measure: Any  # what is measured


class Sample(NamedTuple):
    """What is known at one sample, before the plant moves on."""

    command: Any
    reading: Any
    voltage: Any
    terms: Any  # of the law


def next_command(params: Any, state: Any, given: float) -> Any:
    """Placeholder for the command source; returns (command, state). ``given``: entry of this sample."""
    raise NotImplementedError


def read(params: Any, state: Any, noise: float) -> Any:
    """Placeholder for the plant's sensors; returns the reading. ``noise``: a standard normal number."""
    raise NotImplementedError


def measured(params: Any, state: Any, now: Sample, plant: Any) -> Any:
    """Placeholder for the measures; returns (state, whether the run ends). ``plant``: its present state."""
    raise NotImplementedError


def plant_step(params: Any, state: Any, voltage: Any) -> Any:
    """Placeholder for the plant's step; returns its state one period later."""
    raise NotImplementedError


def shown(plant: Any, now: Sample) -> Any:
    """Placeholder for the signals that are recorded at each sample; returns a tuple of numbers."""
    raise NotImplementedError


def sample(p: Any, source: Any, law: Any, plant: Any, measure: Any, given: float, noise: float) -> Any:
    """Compute one sample with the parameters ``p``; returns Sample, new states and whether the run ends."""
    reading = read(p.plant, plant, noise)
    command, source = next_command(p.source, source, given)
    voltage, law, terms = law_step(p.law, law, command, reading, 0.0)
    now = Sample(command, reading, voltage, terms)
    measure, over = measured(p.measure, measure, now, plant)
    return now, source, law, measure, over


def run_loop(p: Any, s: Any, given: Floats, noise: Floats, signals: Floats, terms: Floats) -> Any:
    """Run one period for each entry of ``given``, or until the measures end it; returns the last states.

    ``signals`` (n×m) receives what ``shown`` returns at each sample, ``terms`` (n×l, or 0×l for none) the
    law's terms.
    """
    record = terms.shape[0] > 0
    source, law, plant, measure = s.source, s.law, s.plant, s.measure
    for k in range(given.shape[0]):
        now, source, law, measure, over = sample(p, source, law, plant, measure, given[k], noise[k])
        row = shown(plant, now)
        for i in range(len(row)):
            signals[k, i] = row[i]
        if record:
            for i in range(len(now.terms)):
                terms[k, i] = now.terms[i]
        if over:
            break
        plant = plant_step(p.plant, plant, now.voltage)
    return Parts(source, law, plant, measure)


PLACES = tuple(f.__name__ for f in (next_command, read, law_step, measured))


def build(
    functions: Mapping[str, Callable[..., Any]], compiled: bool = True, nogil: bool = False
) -> Callable[..., Any]:
    """Make ``run_loop`` from ``functions``, named as above, compiled or in plain Python (the same bits).

    ``nogil``: compiled, it lets other threads of Python run. Raises KeyError for a function that is missing.
    """
    inner = {name: functions[name] for name in PLACES}
    outer = {name: functions[name] for name in ("plant_step", "shown")}
    if compiled:
        ready = {name: compile_function(f) for name, f in outer.items()}
        one = compile_function(sample, {name: compile_function(f) for name, f in inner.items()})
        return compile_function(run_loop, {"sample": one, **ready}, nogil)
    bound: Callable[..., Any] = bind({"sample": sample, "run_loop": run_loop}, {**inner, **outer})["run_loop"]
    return bound


def command_given(params: float, state: float, given: float) -> tuple[float, float]:
    """Command source of a run whose commands [V] are all known beforehand."""
    return given, state


def nothing_measured(params: float, state: float, now: Sample, plant: Any) -> tuple[float, bool]:
    """Measures of a run of which only the signals are wanted."""
    return state, False


def valve_signals(plant: Any, now: Sample) -> tuple[float, float, float]:
    """SIGNALS [V] of a plant: true position, LVDT reading and voltage."""
    return plant.x.x0, now.reading, now.voltage


def parts(law: Any, plant: Any) -> Parts:
    """Parameters, or states, of a loop whose commands are given and in which nothing is measured."""
    return Parts(0.0, law, plant, 0.0)


def run_valve(
    law: types.ModuleType,
    p: Parts,
    begin: Parts,
    commands: Floats,
    noise: Floats,
    signals: Floats,
    terms: Floats,
    compiled: bool = True,
) -> Parts:
    """Run ``law`` on a plant from the states ``begin``, one sample per command [V]; returns the last states.

    ``p``, ``begin``: of ``parts``, with the Params of any plant; ``noise``: standard normal numbers of the
    LVDT; ``signals`` (n×3) receives SIGNALS [V], ``terms`` (n×m, or 0×m for none) the law's terms.
    """
    plant = registry.plant_of(p.plant).module
    loop = build(
        {
            "next_command": command_given,
            "read": plant.read,
            "law_step": law.step,
            "measured": nothing_measured,
            "plant_step": plant.step,
            "shown": valve_signals,
        },
        compiled,
        nogil=True,
    )
    end: Parts = loop(p, begin, commands, noise, signals, terms)
    return end
