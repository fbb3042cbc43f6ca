# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates one whole run offline: law, valve and command as in the nodes, without middleware."""

import types
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control import closed_loop
from valve_control.control.analysis import limit_cycle as limit_cycles
from valve_control.control.analysis import steps
from valve_control.control.analysis.indices import Indices, indices, rms
from valve_control.control.analysis.limit_cycle import LimitCycle, limit_cycle
from valve_control.control.compiling import LawError, explained
from valve_control.control.laws import command_lead, linearisation, reshaping
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.linear import stability
from valve_control.control.parameters import build
from valve_control.control.plant import registry
from valve_control.control.plant.saturation import saturate
from valve_control.control.plant.transfer_functions import LIKE, TransferFunction
from valve_control.control.simulation import delivery
from valve_control.control.simulation.delivery import Delivery
from valve_control.parameter import ParameterError, Values, number, word

PROBES = (0.3, 1.0)  # V  steps with which a valve is tried
PROBE = 1.0  # s  length of a trial, and how long a limit cycle has to be there at its end
PROBE_END = 0.2  # s
CUT = 0.01  # share of the samples, from which on limits that are too low for the valve are told of
PIECE = 1_000_000  # samples between two words about progress


class Run(NamedTuple):
    """Traces and results of one run, all sampled at ``period``."""

    controller: str
    period: float  # s
    command: Floats  # V, of the upper level
    position: Floats  # V, true
    measurement: Floats  # V
    voltage: Floats  # V
    terms: dict[str, Floats]  # of the law, by name
    theta: list[float] | None  # θ̂ at the end, of laws that adapt
    indices: Indices  # error from the measurement, as in the paper
    true_error: dict[str, float]  # from the true position
    at_limit: npt.NDArray[np.bool_]  # samples at the limit of the voltage
    limit_cycle: LimitCycle | None
    warning: str  # "" if none
    steps: tuple[float, float] | None = None  # overshoot [-], settling time [s] of the worst; None: no steps

    @property
    def time(self) -> Floats:
        """Time [s] of each sample."""
        return np.arange(len(self.command), dtype=np.float64) * self.period

    @property
    def saturated(self) -> float:
        """Share of the samples at the limit of the voltage."""
        return float(np.mean(self.at_limit))


class _Loop(NamedTuple):
    """A law around a plant."""

    law: Law
    params: Any  # of the law
    behind: Any  # of the law behind the curve of linearisation
    plant: Any  # Params


def check_agreement(controller_values: Values, valve_values: Values) -> None:
    """Raise ParameterError unless controller and valve have the same sample period and voltage limit."""
    for name in ("sample_period", "u_max"):
        if controller_values[name] != valve_values[name]:
            raise ParameterError(
                f"{name} is {controller_values[name]} for the controller and {valve_values[name]} "
                "for the valve; they must agree"
            )


def simulate(
    controller_values: Values,
    valve_values: Values,
    command: Floats,
    compiled: bool = True,
    noise_start: int = 0,
    told: Callable[[int], None] | None = None,
    alone: bool = False,
    delivered: Delivery | None = None,
    derivatives: tuple[Floats, Floats] | None = None,
) -> Run:
    """Simulate the loop over ``command`` [V], one entry per sample. Raises ParameterError.

    ``noise_start``: how many LVDT readings the simulator had already made when the controller joined.
    ``told`` is called with the number of samples done since its last call. ``alone``: the parameters of
    other laws are not looked at. ``delivered``: how the command comes; None: one for each sample, in time.
    ``derivatives`` [V/s, V/s²]: of a command that comes as points of a trajectory. The error is that from
    ``command`` all the same.
    """
    check_agreement(controller_values, valve_values)
    law = LAWS[word(controller_values, "controller")]
    law_params = law.build(controller_values) if alone else build.law_params(controller_values)
    valve_params = build.valve_params(valve_values)
    limit = number(controller_values, "command_limit")
    wanted = np.ascontiguousarray(command, dtype=np.float64)
    command = np.clip(wanted, -limit, limit)
    period = valve_params.period
    n = len(command)
    labels = law.term_labels
    build.check_memory(noise_start + n, build.OF_A_RUN + len(labels))
    seed = int(number(valve_values, "seed"))
    noise = np.random.default_rng(seed).standard_normal(noise_start + n)[noise_start:]
    loop = _Loop(law, law_params, linearisation.behind(controller_values, law_params), valve_params)
    terms = np.zeros((n, len(labels)))
    if derivatives is None:
        lead = command_lead.build(controller_values, law.reshapes(law_params))
        led = delivery.led(lead, controller_values, command, delivered)
    else:
        beyond = command != wanted
        led = delivery.of_points(law, law_params, command, *(np.where(beyond, 0.0, d) for d in derivatives))
    signals, end = _ran(loop, led, noise, terms, compiled, told)
    position, measurement, voltage = signals.T
    least = number(controller_values, "oscillation_limit")
    warnings_found = [
        *_unstable(loop, controller_values, least, compiled),
        _cut(law, law_params, terms, build.valve_model(valve_values)),
    ]
    true_error = position - command
    rest = position[:1]  # from which a command may begin with a step
    answer = steps.answer(np.concatenate([rest, command]), np.concatenate([rest, position]), period)
    return Run(
        controller=law.name,
        period=period,
        command=command,
        position=position,
        measurement=measurement,
        voltage=voltage,
        terms={label: terms[:, i] for i, label in enumerate(labels)},
        theta=list(end.law.theta) if law.adapts else None,
        indices=indices(measurement - command, voltage, period),
        true_error={"e_M": float(np.max(np.abs(true_error))), "e_rms": rms(true_error)},
        at_limit=_at_limit(voltage, loop.behind, valve_params),
        limit_cycle=limit_cycle(voltage, command, period, least, compiled),
        warning="; ".join(filter(None, warnings_found)),
        steps=None if answer is None else (float(answer.overshoot), float(answer.settling)),
    )


def finite_run(*arguments: Any, **options: Any) -> Run:
    """Run of ``simulate`` whose numbers are finite. Raises LawError at the first that is not."""
    with np.errstate(all="ignore"):
        run = simulate(*arguments, **options)
    numbers = np.column_stack([run.voltage, run.measurement, *run.terms.values()])
    bad = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
    if len(bad):
        raise LawError(f"{run.controller} produced NaN or infinity after {bad[0] * run.period:.3f} s")
    return run


def _at_limit(voltage: Floats, law: Any, plant: Any) -> npt.NDArray[np.bool_]:
    """Whether ``voltage`` [V] of the amplifier is at its limit by the Params of ``law`` and ``plant``."""
    if not isinstance(law, linearisation.Params):
        return np.asarray(np.abs(voltage) >= plant.u_max)
    low, high = (linearisation.value(law.inverse, side * law.law.u_max) for side in (-1.0, 1.0))
    return (voltage <= low) | (voltage >= high)


def _cut(law: Law, params: Any, terms: Floats, model: TransferFunction) -> str:
    """One sentence if limits far below what the valve can do cut the reference in a run with these ``terms``.

    ``terms``: n×m, as the law names them.
    """
    if not law.reshapes(params):
        return ""
    own: reshaping.Params = params.reshaping
    could = reshaping.limits(model, params.u_max)
    said = []
    for name, term, limit in (
        ("reshaping.max_accel", "reference_accel", own.max_accel),
        ("reshaping.max_rate", "reference_rate", own.max_rate),
    ):
        if term in law.term_labels and name in could and LIKE * limit < number(could, name):
            share = float(np.mean(np.abs(terms[:, law.term_labels.index(term)]) >= limit * (1.0 - 1e-9)))
            if share > CUT:
                said.append(
                    f"{name} {limit:g} cuts the reference in {100.0 * share:.2g} % of the samples, and the "
                    f"valve can follow {number(could, name):g}"
                )
    return "; ".join(said)


def at_rest(law: types.ModuleType, law_params: Any, plant: Any, noise: float) -> closed_loop.Parts:
    """States of a loop at rest, whose law starts from the first reading with this ``noise``."""
    module = registry.plant_of(plant).module
    rest = module.initial(plant)
    first = module.read(plant, rest, noise)
    return closed_loop.parts(law.initial(law_params, Start(first, 0.0, first, 0.0, 0.0)), rest)


def _ran(
    loop: _Loop, led: Floats, noise: Floats, terms: Floats, compiled: bool, told: Callable[[int], None] | None
) -> tuple[Floats, Any]:
    """Signals (n×3) of the ``loop`` from rest under the commands ``led`` [V], n, and its last state.

    ``terms``: n rows for those of the law, or none.
    """
    n = len(led)
    signals = np.full((n, len(closed_loop.SIGNALS)), np.nan)  # of samples that are not computed yet
    module = linearisation.module_of(loop.law.module, loop.behind)
    end = at_rest(module, loop.behind, loop.plant, noise[0])
    params = closed_loop.parts(loop.behind, loop.plant)
    try:
        with explained(loop.law.title):
            for start in range(0, n, PIECE):
                piece = slice(start, start + PIECE)
                end = closed_loop.run_valve(
                    module, params, end, led[piece], noise[piece], signals[piece], terms[piece], compiled
                )
                if told is not None:
                    told(len(led[piece]))
    except LawError as error:
        time = np.argmax(np.isnan(signals[:, 0])) * loop.plant.period  # of the first that is not computed
        raise LawError(f"{error} after {time:.3f} s") from error
    return signals, end


def _unstable(loop: _Loop, values: Values, least: float, compiled: bool) -> list[str]:
    """Sentences about a loop that is unstable, or may swing by more than ``least`` [V]; "" for none.

    ``values``: of the controller, with the curve of its linearisation.
    """
    law, params, _, plant = loop
    on_valve = stability.valve_warning(law, params, plant, values)
    return [stability.warning(law, params), on_valve or _probe(loop, least, compiled)]


def _probe(loop: _Loop, least: float, compiled: bool) -> str:
    """One sentence if a step brings the ``loop`` into a limit cycle, else "".

    The poles know nothing of saturation, friction and adaptation, with which a loop that is stable for small
    motions can go on for ever after a larger one. Tried without noise and drift.
    """
    if not loop.law.feedback or least == 0.0:
        return ""
    period, kind = loop.plant.period, registry.plant_of(loop.plant)
    quiet = loop._replace(plant=kind.steady(kind.quiet(loop.plant)))
    n = round(PROBE / period)
    unheard = np.zeros((0, len(loop.law.term_labels)))
    for height in PROBES:
        command = np.full(n, height)
        command[0] = 0.0
        signals, _ = _ran(quiet, command, np.zeros(n), unheard, compiled, None)
        cycle = limit_cycle(signals[:, 2], command, period, least, compiled)
        if cycle is not None and cycle.end > PROBE - PROBE_END:
            return (
                f"on this valve a step of {height:g} V brings {loop.law.name} into a limit cycle at "
                f"{cycle.frequency:.3g} Hz with {cycle.amplitude:.2g} V, although its poles at rest are "
                "stable; lower the gains"
            )
    return ""


def law_function(values: Values) -> Callable[[float, float], float]:
    """The law, from rest, as a function: voltage [V] from command and reading [V]. Raises ParameterError."""
    kind, limit = LAWS[word(values, "controller")], number(values, "command_limit")
    own = kind.build(values)
    params = linearisation.behind(values, own)
    law, lead = linearisation.module_of(kind.module, params), command_lead.build(values, kind.reshapes(own))
    memory: list[Any] = []  # of lead and law

    def voltage(command: float, reading: float) -> float:
        """Voltage [V] from ``command`` and ``reading`` [V], once for each sample."""
        if np.ndim(command) or np.ndim(reading):
            raise ParameterError("the law takes one sample a call: two floats, no arrays")
        wanted = saturate(command, limit)
        start = Start(reading, 0.0, reading, 0.0, 0.0)
        before, state = memory or (command_lead.initial(wanted), law.initial(params, start))
        if lead is not None:
            before = command_lead.step(lead, before, wanted)
            wanted = command_lead.led(lead, before, wanted)
        result, state, _ = law.step(params, state, wanted, reading, 0.0)
        memory[:] = before, state
        return float(result)

    return voltage


def as_dict(run: Run, settings: Mapping[str, Values]) -> dict[str, Any]:
    """``run`` with the ``settings`` by node that it had, for JSON."""
    return {
        "controller": run.controller,
        "valve": settings["valve_simulator"]["valve"],
        "scenario": settings["command_source"]["scenario"],
        "sample_period": run.period,
        "duration": len(run.command) * run.period,
        "seed": settings["valve_simulator"]["seed"],
        "indices": run.indices._asdict(),
        "true_error": run.true_error,
        "steps": run.steps and dict(zip(("overshoot", "settling_s"), run.steps, strict=True)),
        "theta": run.theta,
        **limit_cycles.as_dict(run.saturated, run.limit_cycle),
        "warning": run.warning or None,
    }
