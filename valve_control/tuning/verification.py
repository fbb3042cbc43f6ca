"""Verifies gains on valves, noise and motions that the search did not see, before they are accepted."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.analysis.limit_cycle import limit_cycle
from valve_control.laws.law import Law
from valve_control.laws.registry import LAWS
from valve_control.parameter import Values, number, updated
from valve_control.parameters.table import CONTROLLER
from valve_control.plant import valve
from valve_control.simulation import batch
from valve_control.tuning import margins, trial
from valve_control.tuning.trial import Gains, Motion, Outcome, Problem, Workers

Array = npt.NDArray[np.float64]
SLOWER = 1.1  # times as long: a motion of the search, turned over, as one that it did not see
STEPS_NAME = "steps"
STEPS = (0.3, -1.0)  # V  with which a loop is tried; each is held for HELD
HELD = 1.0  # s
RESTING = 0.5  # s  at the end of each step, in which the loop has to rest
REST = 0.05  # V  amplitude about a straight line from which on it does not: noise stays far below
TURNS = 4  # crossings of that line; what creeps has two
OWN = 2.0  # times a valve's own swing at a constant voltage, up to which that of the loop is the valve's
LEAST = 0.01  # V  amplitude of a valve's own swing, at least
SETTLED = 2.0  # s  after which a valve at a constant voltage rests, unless it swings by itself
CHUNK = 512  # valves whose signals are kept at a time
SLACK = 1.05  # times the limit of the chatter, which valves that were not seen may have


class Verified(NamedTuple):
    """What gains reach on valves that the search did not see."""

    seen: Outcome  # on the motions of the search
    unseen: Outcome  # on others
    margins: margins.Margins  # of each valve
    cycling: npt.NDArray[np.int64]  # numbers of valves on which steps or motions end in a limit cycle
    reasons: list[str]  # why the gains are not accepted, as sentences; []: they are


def other_motions(motions: Sequence[Motion]) -> list[Motion]:
    """The ``motions`` turned over and slower: others of the same size that the valve can follow as well."""
    made = []
    for motion in motions:
        n = len(motion.wanted)
        times = np.arange(round(n * SLOWER)) / SLOWER
        slower = -np.interp(times, np.arange(n), motion.wanted)
        made.append(Motion(f"{motion.name}, turned over and slower", slower))
    return made


def steps(period: float) -> Motion:
    """Steps of STEPS from 0 V, each held for HELD."""
    n = round(HELD / period)
    return Motion(STEPS_NAME, np.concatenate([np.zeros(n // 10), *(np.full(n, height) for height in STEPS)]))


def cycling(
    law: Law, problem: Problem, gains: Gains, plants: Sequence[valve.Params], workers: Workers = None
) -> npt.NDArray[np.int64]:
    """Numbers of the ``plants`` on which the loop ends in a limit cycle, after steps or after a motion.

    Each step, and the end of each motion, is held for HELD; in the last RESTING of it the spool has to rest,
    and the voltage must not show what a controller node reports as an oscillation. While a command moves,
    friction answers it with harmonics, which are no limit cycle. A run that does not stay finite counts. A
    valve that swings at a constant voltage, and in the loop less than OWN times as much, does not.
    """
    values = trial.values_with(problem, gains)
    params = law.build(values)
    period, least = number(values, "sample_period"), number(values, "oscillation_limit")
    bare = problem._replace(preview=False)  # nobody sends the derivatives of a step
    held = round(HELD / period)
    tried = [(steps(period), bare)]
    for motion in problem.motions:
        still = np.full(held, motion.wanted[-1])
        tried.append((motion._replace(wanted=np.concatenate([motion.wanted, still])), problem))
    found: dict[int, _Swing] = {}
    for motion, sender in tried:
        led = trial.given(law, params, values, gains, sender, motion.wanted)
        ends = [len(led), len(led) - held] if motion.name == STEPS_NAME else [len(led)]
        for first in range(0, len(plants), CHUNK):
            some = plants[first : first + CHUNK]
            traces = np.empty((len(some), len(led), 3))
            seeds = problem.seed + first + np.arange(len(some))
            batch.simulate(
                batch.Batch(law.name, params, batch.records(list(some)), seeds, motion.wanted, led=led),
                trial.threads_of(workers),
                traces,
            )
            for i, trace in enumerate(traces):
                for end in ends:
                    part = trace[end - held : end]
                    if _restless(part, period, least):
                        found[first + i] = max(found.get(first + i, _Swing(0.0, 0.0)), _swing(part, period))
    return _by_feedback(values, plants, found, trial.threads_of(workers))


class _Swing(NamedTuple):
    """A swing about rest."""

    amplitude: float  # V
    voltage: float  # V  mean


def _swing(trace: Array, period: float) -> _Swing:
    """Of the end of a ``trace`` (n×3) at one command."""
    last = trace[-round(RESTING / period) :]
    amplitude = _amplitude(_about_a_line(last[:, 0]))
    return _Swing(amplitude if math.isfinite(amplitude) else math.inf, float(np.mean(last[:, 2])))


def _amplitude(swing: Array) -> float:
    """Amplitude of the sine that is as large, root mean square, as a ``swing`` about 0 V."""
    return math.sqrt(2.0) * float(np.std(swing))


def _about_a_line(position: Array) -> Array:
    times = np.linspace(-1.0, 1.0, len(position))
    swing = position - np.mean(position)
    made: Array = swing - times * (times @ swing) / (times @ times)
    return made


def _crossings(swing: Array) -> int:
    """Of a ``swing`` about 0 V."""
    return int(np.count_nonzero(np.diff(np.signbit(swing))))


def _by_feedback(
    values: Values, plants: Sequence[valve.Params], found: Mapping[int, _Swing], threads: int | None
) -> npt.NDArray[np.int64]:
    """Numbers of those ``found`` that are not the valve's own swings at a constant voltage."""
    numbers = sorted(found)
    bare = LAWS["open_loop"]
    params = bare.build(updated(CONTROLLER, values, {"open_loop.static_gain": 1.0}))
    period = number(values, "sample_period")
    kept = []
    for first in range(0, len(numbers), CHUNK):
        some = numbers[first : first + CHUNK]
        voltages = np.nan_to_num([found[i].voltage for i in some], posinf=0.0, neginf=0.0)
        command = np.repeat(voltages[:, None], round(SETTLED / period), axis=1)
        traces = np.empty((*command.shape, 3))
        rows = batch.records([plants[i] for i in some])
        batch.simulate(batch.Batch(bare.name, params, rows, np.array(some), command), threads, traces)
        for i, trace in zip(some, traces, strict=True):
            own = _about_a_line(trace[-round(RESTING / period) :, 0])
            amplitude = _amplitude(own)
            swings = amplitude > LEAST and _crossings(own) >= TURNS
            if not (swings and OWN * amplitude > found[i].amplitude):
                kept.append(i)
    return np.array(kept, dtype=np.int64)


def _restless(trace: Array, period: float, least: float) -> bool:
    """Whether the loop still swings at the end of a ``trace`` (n×3) at one command, or is not finite."""
    if not np.all(np.isfinite(trace)):
        return True
    last = round(RESTING / period)
    voltage = trace[:, 2]
    swing = _about_a_line(trace[-last:, 0])
    if float(np.ptp(swing)) > 2.0 * REST and _crossings(swing) >= TURNS:
        return True
    cycle = limit_cycle(voltage, np.zeros(len(voltage)), period, least)
    return cycle is not None and cycle.end > HELD - RESTING


def verified(
    law: Law,
    problem: Problem,
    gains: Gains,
    chatter: float | None,
    workers: Workers = None,
) -> Verified:
    """Try ``gains`` on ``problem``, whose valves and seed are others than those of the search.

    ``chatter``: the limit that was asked for, None: none.
    """
    params = law.build(trial.values_with(problem, gains))
    found = margins.margins(law, params, margins.prepared([*problem.box, *problem.plants]))
    seen = trial.run(law, problem, [gains], workers)[0]
    others = problem._replace(motions=other_motions(problem.motions), seed=problem.seed + 500_000)
    unseen = trial.run(law, others, [gains], workers)[0]
    cycles = cycling(law, others, gains, problem.plants, workers)
    reasons = [*_margins_missed(problem.limits, margins.as_dict(margins.worst(found)))]
    if not np.all(np.isfinite(seen.e_rms)) or not np.all(np.isfinite(unseen.e_rms)):
        reasons.append("a run does not stay finite")
    if len(cycles):
        reasons.append(f"{len(cycles)} of {len(problem.plants)} valves end in a limit cycle")
    for outcome, what in ((seen, "the commands"), (unseen, "commands that were not seen")):
        share = float(np.mean(outcome.saturated))
        if share > problem.limits.saturated:
            reasons.append(f"on {what} the amplifier saturates in {100.0 * share:.2g} % of the samples")
    if chatter is not None and not seen.chatter <= SLACK * chatter:
        reasons.append(f"c_u is {seen.chatter:.3f} on valves that were not seen, above {chatter:g}")
    return Verified(seen, unseen, found, cycles, reasons)


def _margins_missed(limits: trial.Limits, worst: dict[str, float | None]) -> list[str]:
    if (worst["radius"] or 0.0) >= 1.0 + margins.EDGE:
        return [f"a valve of the box makes the loop unstable (largest pole {worst['radius']:.4f})"]
    texts = {
        "gain_db": ("gain margin", "dB", 1.0, limits.gain_db),
        "reduction_db": ("gain margin downwards", "dB", 1.0, limits.gain_db),
        "phase_deg": ("phase margin", "deg", 1.0, limits.phase_deg),
        "delay_s": ("delay margin", "ms", 1e3, limits.delay_s),
    }
    reasons = []
    for name, (text, unit, scale, limit) in texts.items():
        value = worst[name]
        if value is not None and value < limit:
            reasons.append(
                f"the {text} falls to {scale * value:.3g} {unit} in the box, below {scale * limit:g} {unit}"
            )
    peak = worst["sensitivity_db"]
    if peak is None or peak > limits.sensitivity_db:
        shown = "without end" if peak is None else f"{peak:.3g} dB"
        reasons.append(f"the sensitivity peaks at {shown}, above {limits.sensitivity_db:g} dB")
    swing = worst["swing_v"]
    if swing is None or swing > limits.swing:
        shown = "any size" if swing is None else f"{swing:.3g} V"
        reasons.append(
            f"feedback adds {shown} to the swing that friction sustains about rest, above {limits.swing:g} V"
        )
    return reasons


def as_dict(v: Verified) -> dict[str, Any]:
    """For JSON: errors [V], geometric mean of the motions at median and 95th percentile of the valves."""

    def percentiles(errors: Array) -> dict[str, float | None]:
        if not np.all(np.isfinite(errors)):
            return {"median": None, "p95": None}
        middle, tail = np.exp(np.mean(np.log(np.percentile(errors, [50, trial.TAIL], axis=1)), axis=1))
        return {"median": float(middle), "p95": float(tail)}

    return {
        "e_rms": percentiles(v.seen.e_rms),
        "e_max": percentiles(v.seen.e_max),
        "c_u": v.seen.chatter if np.isfinite(v.seen.chatter) else None,
        "saturated": float(np.mean(v.seen.saturated)),
        "unseen_commands": {
            "e_rms": percentiles(v.unseen.e_rms),
            "c_u": v.unseen.chatter if np.isfinite(v.unseen.chatter) else None,
        },
        "valves": v.seen.e_rms.shape[1],
        "limit_cycles": len(v.cycling),
    }
