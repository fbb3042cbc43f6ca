# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tests Theorems 1 A and 2 A on random valves: V2 must stay below its bound, (25) or (52).

Each case is a second-order valve inside its assumed ranges, a motion, a bounded disturbance d̃ and a start.
Every law meets the same cases at every sample period. The laws' own ``step`` runs; the reshaping passes
the motion on with its exact derivatives. The plant is simulated exactly, with the disturbance constant
over ``SUBSTEP``. A run ends where the voltage saturates, since nothing is promised from there on.

The gains are the paper's. ε is drawn below h²/(4k), h = bound on |θ̃ᵀφ| + |d̃| along the motion: the
robust term then adds up to k·h²/(4k·ε) to the loop's gain k. Larger ε would give a bound that nothing
comes near. The ranges of valves, motions and disturbances are such that ±10 V hardly ever saturates.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from research.theorems import bench
from research.theorems.bench import Array, CosineReference, Course, Plant, Progress, Spool, Wanted
from valve_control.control import closed_loop
from valve_control.control.laws import arc, lyapunov_bound, oarc, registry, reshaping, velocity
from valve_control.control.laws.projection import Theta, span
from valve_control.control.laws.signals import Start
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import defaults, updated

PERIODS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5)  # s
SUBSTEP = 2e-5  # s
SETTLED = 0.03  # s; exp(-240·0.03) = 0.0007
DURATION = 0.4  # s; about 100 time constants of the bound
KINDS = ("piecewise", "sine", "bang-bang")
U_MAX = 10.0  # V
SMALL = 1e-6  # V, V/s; errors from which no gain can be read
TIGHTNESS = (0.03, 1.0)  # ε over h²/(4k); ten times that for OARC, whose start would saturate otherwise
CHUNK = 250  # valves in one task


class Push(NamedTuple):
    """A disturbance d̃ with |d̃| <= size."""

    kind: float  # index into KINDS
    size: float  # V/s²  δ_d
    frequency: float  # Hz    of the sine; levels per second of the piecewise one
    phase: float  # rad


class Case(NamedTuple):
    """One valve with motion, disturbance and start."""

    truth: Theta  # θ
    lower: Theta  # θmin
    upper: Theta  # θmax
    estimate: Theta  # θ̂(0)
    motion: CosineReference
    push: Push
    levels: Array  # -     of the piecewise disturbance, within ±1
    adaptation: float  # -     multiplies the paper's Γ
    tightness: float  # -     ε over h²/(4k)
    start: float  # -     V2(0) over ε/λ, about
    side: float  # ±1    of the first error


class Outcome(NamedTuple):
    """Results of one run, one row of an array of floats; NaN for what a run that saturated did not reach."""

    ratio: float  # -   largest V2 over its bound, after the first sample
    settled: float  # -   the same once the bound has forgotten V2(0), after SETTLED
    time: float  # s   of the largest ratio
    excess: float  # -   largest growth of V2 beyond the inequality of one period, over ε
    loop_gain: float  # -   largest gain of the law's feedback, robust term included, times ΔT
    peak: float  # V   largest voltage asked for
    saturated: float  # 1.0 if the run ended in saturation


class Cell(NamedTuple):
    """Results of all runs of one law at one sample period; arrays have an entry per valve."""

    law: str
    period: float  # s
    kinds: Array  # index into KINDS
    adaptation: Array  # multiplies the paper's Γ
    ratio: Array
    settled: Array
    time: Array  # s
    excess: Array
    loop_gain: Array
    peak: Array  # V
    saturated: Array

    @property
    def checked(self) -> int:
        """Runs with at least one checked step: they did not saturate at the very first sample."""
        return int(np.sum(np.isfinite(self.ratio)))

    @property
    def checked_later(self) -> int:
        """Runs that came beyond SETTLED."""
        return int(np.sum(np.isfinite(self.settled)))

    @property
    def saturated_at_start(self) -> int:
        """Runs that saturated at the first sample, of which nothing is known."""
        return len(self.ratio) - self.checked

    @property
    def saturated_later(self) -> int:
        """Checked runs that ended in saturation."""
        return int(np.sum(self.saturated > 0.0)) - self.saturated_at_start

    @property
    def breaches(self) -> int:
        """Runs in which V2 ever exceeded its bound."""
        return int(np.sum(self.ratio > 1.0))

    @property
    def later_breaches(self) -> int:
        """Those that exceeded it after SETTLED, and not only while it still remembered V2(0)."""
        return int(np.sum(self.settled > 1.0))

    @property
    def worst(self) -> float:
        """Largest V2 over its bound; NaN if no run was checked."""
        return largest(self.ratio)

    def quantile(self, share: float) -> float:
        """Margin V2/bound that ``share`` of the checked runs stay below; NaN if there is none."""
        return bench.quantile(self.ratio, share)


def largest(values: Array) -> float:
    """Largest finite entry; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else math.nan


class Scaling(NamedTuple):
    """How the inequality of one period, dV2 <= (ε - λ·V2)·ΔT, is missed as ΔT grows, over ε."""

    law: str
    periods: Array  # s
    shift: Array  # -  median over the valves of |excess(ΔT) - excess(shortest ΔT)|
    order: float  # -  slope of log shift over log ΔT


class Experiment(NamedTuple):
    """Results for Theorems 1 A and 2 A on random valves."""

    seed: int
    valves: int
    duration: float  # s
    cells: tuple[Cell, ...]

    def cell(self, law: str, period: float) -> Cell:
        """Runs of ``law`` at ``period`` [s]."""
        return next(c for c in self.cells if c.law == law and c.period == period)

    def scaling(self, law: str) -> Scaling:
        """Sampling error of ``law`` over ΔT, from the same valves at every ΔT that never saturated."""
        cells = sorted((c for c in self.cells if c.law == law), key=lambda c: c.period)
        cells = [c for c in cells if np.mean(c.saturated) < 0.25]
        if not cells:
            return Scaling(law, np.empty(0), np.empty(0), math.nan)
        finest, *others = cells
        sound = np.all([c.saturated == 0.0 for c in (finest, *others)], axis=0)
        periods = np.array([c.period for c in others])
        shift = np.array([np.median(np.abs(c.excess - finest.excess)[sound]) for c in others])
        return Scaling(law, periods, shift, bench.order(periods - finest.period, shift))


def draw(seed: int, number: int) -> Case:
    """Case ``number`` of a seed.

    Seven valves in ten are corners of their box and start from the estimate in the opposite corner; every
    other of these is the corner whose errors all push the same way along this motion.
    """
    rng = np.random.default_rng([seed, number])
    centre = rng.uniform([20.0, 1000.0, 1000.0, -300.0], [80.0, 2000.0, 1800.0, 300.0])
    half = np.append(rng.uniform(0.01, 0.06, 3) * centre[:3], rng.uniform(20.0, 200.0))
    side = float(rng.choice([-1.0, 1.0]))
    corner = [rng.choice([-1.0, 1.0], 4), np.array([1.0, side, -side, -1.0])][number // len(KINDS) % 2]
    place, guess = (corner, -corner) if rng.random() < 0.7 else rng.uniform(-1.0, 1.0, (2, 4))
    motion = CosineReference(
        start=side * rng.uniform(0.0, 1.0),
        a1=side * rng.uniform(0.2, 0.8),
        w1=2.0 * math.pi * rng.uniform(0.3, 2.0),
        a2=rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.15),
        w2=2.0 * math.pi * rng.uniform(2.0, 6.0),
        a3=0.0,
        w3=0.0,
    )
    return Case(
        truth=Theta(*(float(v) for v in centre + place * half)),
        lower=Theta(*(float(v) for v in centre - half)),
        upper=Theta(*(float(v) for v in centre + half)),
        estimate=Theta(*(float(v) for v in centre + guess * half)),
        motion=CosineReference(*(float(v) for v in motion)),
        push=Push(
            float(number % len(KINDS)),
            float(rng.uniform(50.0, 400.0)),
            float(math.exp(rng.uniform(0.0, math.log(300.0)))),
            float(rng.uniform(0.0, 2.0 * math.pi)),
        ),
        levels=rng.uniform(-1.0, 1.0, 61),
        adaptation=float(math.exp(rng.uniform(0.0, math.log(100.0)))),
        tightness=float(math.exp(rng.uniform(*np.log(TIGHTNESS)))),
        start=float(rng.uniform(0.0, 3.0)),
        side=side,
    )


def uncertainty(case: Case) -> float:
    """Bound h [V/s²] on |θ̃ᵀφ| + |d̃| of (22) along the motion, all extremes at once."""
    m, low = case.motion, case.lower
    position = abs(m.start) + 2.0 * (abs(m.a1) + abs(m.a2))
    rate = abs(m.a1) * m.w1 + abs(m.a2) * m.w2
    accel = abs(m.a1) * m.w1**2 + abs(m.a2) * m.w2**2
    voltage = (low.a1 * rate + low.a0 * position + accel) / low.b0
    s = span(case.lower, case.upper)
    return s.a1 * rate + s.a0 * position + s.b0 * voltage + s.b0dn + case.push.size


def disturbance(push: Push, levels: Array, time: float, direction: float) -> float:
    """Disturbance d̃ [V/s²] at ``time`` [s]; the bang-bang one goes where V2 grows most, ``direction``."""
    if push.kind == 0.0:
        return push.size * float(levels[int(time * push.frequency) % len(levels)])
    if push.kind == 1.0:
        return push.size * math.sin(2.0 * math.pi * push.frequency * time + push.phase)
    return math.copysign(push.size, direction)


@functools.cache
def _scaled(law: str, period: float) -> Any:
    changes = {"sample_period": period, "u_max": U_MAX, f"{law}.robust_term": "quadratic"}
    p: Any = registry.LAWS[law].build(updated(CONTROLLER, defaults(CONTROLLER), changes))
    return p._replace(reshaping=bench.unlimited(period))


@functools.cache
def _observer_peak(k1: float, k2: float) -> float:
    return bench.observer_peak(k1, k2)


def _gamma(gamma: Theta, scale: float) -> Theta:
    return Theta(*(scale * g for g in gamma))


def arc_case(case: Case, period: float, filtered: bool) -> tuple[arc.Params, arc.State, float, float]:
    """ARC for this case, its state, and the valve's position [V] and velocity [V/s] at the start."""
    base: arc.Params = _scaled("arc", period)
    epsilon = case.tightness * uncertainty(case) ** 2 / (4.0 * base.k2)
    p = base._replace(
        gamma=_gamma(base.gamma, case.adaptation),
        theta_initial=case.estimate,
        theta_min=case.lower,
        theta_max=case.upper,
        epsilon=epsilon,
        disturbance_bound=case.push.size,
        velocity=base.velocity if filtered else bench.KEEPS_VELOCITY,
    )
    x1 = case.motion.start
    x2 = case.side * math.sqrt(2.0 * case.start * epsilon / (2.0 * min(p.k1, p.k2)))
    return p, arc.initial(p, Start(x1, 0.0, x1, 0.0, x2)), x1, x2


def oarc_case(case: Case, period: float) -> tuple[oarc.Params, oarc.State, float, float]:
    """OARC for this case, its state, and the valve's position [V] and velocity [V/s] at the start.

    The valve rests under the voltage that the K-filters know of: ε of (32) is zero, as the law has no
    α1s3 and no u_s3 against it.
    """
    base: oarc.Params = _scaled("oarc", period)
    c, rho, low = 10.0 * case.tightness, base.z2_weight, case.lower.b0
    h1 = uncertainty(case) * base.k1 / base.k2
    slope = base.ks1 / low * (1.0 + 1.0 / c)
    p = base._replace(
        gamma=_gamma(base.gamma, case.adaptation),
        theta_initial=case.estimate,
        theta_min=case.lower,
        theta_max=case.upper,
        epsilon1=c * h1 * h1 / (4.0 * base.ks1),
        epsilon2=c * rho * (slope * h1) ** 2 / (4.0 * base.ks2),
        disturbance_bound=case.push.size * _observer_peak(base.k1, base.k2),
    )
    wanted = case.start * (p.epsilon1 + p.epsilon2) / (2.0 * min(p.ks1, p.ks2))
    x1 = case.motion.start + case.side * math.sqrt(2.0 * wanted / (1.0 + rho * slope * slope))
    voltage = (case.truth.a0 * x1 - case.truth.b0dn) / case.truth.b0
    return p, oarc.initial(p, Start(x1, voltage, x1, 0.0, 0.0)), x1, 0.0


def arc_given(p: arc.Params, s: arc.State, reference: reshaping.State, x1: float, x2: float) -> arc.State:
    """ARC's state with the motion's reference, and the true velocity unless it has a filter of its own."""
    if p.velocity.smoothing == 0.0:
        return arc.State(reference, velocity.State(x1, x2), s.theta, s.bound)
    return arc.State(reference, s.velocity, s.theta, s.bound)


def oarc_given(p: oarc.Params, s: oarc.State, reference: reshaping.State, x1: float, x2: float) -> oarc.State:
    """OARC's state with the motion's reference."""
    return oarc.State(reference, s.eta, s.v0, s.psi, s.theta, s.bound)


def arc_lyapunov(p: arc.Params, terms: arc.Terms, x2: float) -> float:
    """V2 [V²/s²] of (24) from the true velocity [V/s]."""
    z2 = x2 - terms.reference_rate + p.k1 * terms.z1
    return 0.5 * terms.z1 * terms.z1 + 0.5 * z2 * z2


def oarc_lyapunov(p: oarc.Params, terms: oarc.Terms, x2: float) -> float:
    """V2 [V²] of (47)."""
    return terms.lyapunov


def arc_direction(p: arc.Params, terms: arc.Terms) -> float:
    """Sign of ∂(dV2/dt)/∂d̃, from (24)."""
    return terms.z2


def oarc_direction(p: oarc.Params, terms: oarc.Terms) -> float:
    """Sign of ∂(dV2/dt)/∂ε_u,2, from (41) and (49), without the robust term's share of ∂α1/∂x1."""
    return terms.z1 - p.z2_weight * (terms.a1 / terms.b0 - p.ks1 / p.theta_min.b0) * terms.z2


def arc_growth(p: arc.Params) -> float:
    """ε_V of (25)."""
    return p.epsilon


def oarc_growth(p: oarc.Params) -> float:
    """ε11 + ε21 of (52)."""
    return p.epsilon1 + p.epsilon2


def arc_gain(terms: arc.Terms, b0: float) -> float:
    """Feedback gain [1/s] of the loop around z2, (22), on a valve with this ``b0`` [1/s²]."""
    if abs(terms.z2) < SMALL:
        return 0.0
    return b0 * abs((terms.feedback_voltage + terms.robust_voltage) / terms.z2)


def oarc_gain(terms: oarc.Terms, b0: float) -> float:
    """Larger feedback gain [1/s] of the loops around z1, (40), and z2, (46)."""
    outer = inner = 0.0
    if abs(terms.z1) > SMALL:
        alpha_s = (terms.velocity - terms.reference_rate) / terms.b0 - terms.z2  # α1s, by (38) and (39)
        outer = b0 * abs(alpha_s / terms.z1)
    if abs(terms.z2) > SMALL:
        inner = abs((terms.feedback_voltage + terms.robust_voltage) / terms.z2)
    return max(outer, inner)


class Law(NamedTuple):
    """What the experiment needs of one law; all fields but ``text`` and ``case`` go into ``run_valve``."""

    text: str
    case: Callable[[Case, float], tuple[Any, Any, float, float]]
    law_step: Callable[..., Any]
    given: Callable[..., Any]
    lyapunov: Callable[..., Any]
    direction: Callable[..., Any]
    growth: Callable[..., Any]
    gain: Callable[..., Any]


_ARC = Law(
    text="ARC, true velocity",
    case=functools.partial(arc_case, filtered=False),
    law_step=arc.step,
    given=arc_given,
    lyapunov=arc_lyapunov,
    direction=arc_direction,
    growth=arc_growth,
    gain=arc_gain,
)
LAWS = {
    "arc": _ARC,
    "arc_filtered": _ARC._replace(
        text="ARC, velocity from the LVDT",
        case=functools.partial(arc_case, filtered=True),
    ),
    "oarc": Law(
        text="OARC",
        case=oarc_case,
        law_step=oarc.step,
        given=oarc_given,
        lyapunov=oarc_lyapunov,
        direction=oarc_direction,
        growth=oarc_growth,
        gain=oarc_gain,
    ),
}
SWITCHED = Law._fields[2:]


law_step = given = lyapunov = direction = growth = gain = bench.missing  # of a Law, put in by loop_for


class Valve(NamedTuple):
    """A valve with its disturbance."""

    step: Plant  # over one of ``substeps`` parts of a period
    part: float  # s
    substeps: int
    b0: float  # 1/s²
    b0dn: float  # V/s²
    push: Push
    levels: Array


def valve_of(case: Case, period: float) -> Valve:
    """The valve of ``case`` for a sample ``period`` [s], over which its disturbance changes every SUBSTEP."""
    substeps = max(1, round(period / SUBSTEP))
    part = period / substeps
    truth = case.truth
    return Valve(bench.plant(truth, part), part, substeps, truth.b0, truth.b0dn, case.push, case.levels)


class Given(NamedTuple):
    """Output of the law's step: voltage, and the direction in which a disturbance does most harm."""

    voltage: float  # V
    towards: float
    time: float  # s


class Watch(NamedTuple):
    """Parameters with which V2 is compared with its bound."""

    law: Any  # Params
    b0: float  # 1/s²  of the true valve


class Seen(NamedTuple):
    """V2 and its bound until now, and what was found."""

    first: bool  # before the first sample
    before: float  # V2 at the sample before
    bound: float
    outcome: Outcome


def driven(p: Any, s: Any, wanted: Wanted, spool: Spool, offset: float) -> Any:
    """Step of the law, with the motion as its reference."""
    s = given(p, s, reshaping.State(wanted.position, wanted.rate), spool.x1, spool.x2)
    voltage, s, terms = law_step(p, s, wanted.command, spool.x1, offset)
    return Given(voltage, direction(p, terms), wanted.time), s, terms


def pushed(p: Valve, s: Spool, now: Given) -> Spool:
    """State of the valve one period later, under its disturbance."""
    for i in range(p.substeps):
        push = disturbance(p.push, p.levels, now.time + i * p.part, now.towards)
        s = bench.moved(p.step, s, p.b0 * now.voltage + p.b0dn + push)
    return s


def watched(p: Watch, s: Seen, now: closed_loop.Sample, spool: Spool) -> tuple[Seen, bool]:
    """Compare V2 with its bound; a run ends where the voltage saturates."""
    o, terms = s.outcome, now.terms
    ratio, settled, time, excess, loop_gain = o.ratio, o.settled, o.time, o.excess, o.loop_gain
    allowed = growth(p.law)
    v2 = lyapunov(p.law, terms, spool.x2)
    bound = v2
    if not s.first:
        bound = lyapunov_bound.advance(p.law.lyapunov_bound, s.bound, allowed, True)
        if not v2 <= ratio * bound:
            ratio, time = v2 / bound, now.voltage.time
        if now.voltage.time > SETTLED and not v2 <= settled * bound:
            settled = v2 / bound
        beyond = v2 - lyapunov_bound.advance(p.law.lyapunov_bound, s.before, allowed, True)
        beyond /= p.law.lyapunov_bound.gain * allowed
        if not beyond <= excess:
            excess = beyond
    peak = max(o.peak, abs(terms.unsaturated_voltage))
    over = now.voltage.voltage != terms.unsaturated_voltage
    if not over:
        gained = gain(terms, p.b0) * p.law.period
        if not gained <= loop_gain:
            loop_gain = gained
    outcome = Outcome(ratio, settled, time, excess, loop_gain, peak, 1.0 if over else 0.0)
    return Seen(False, v2, bound, outcome), over


def nothing(spool: Spool, now: closed_loop.Sample) -> tuple[float]:
    """Empty row: no signal is recorded."""
    return (0.0,)


def loop_for(law: str, compiled: bool = True) -> Callable[..., Outcome]:
    """``run_valve`` under ``law``, compiled or in plain Python.

    Laws that share their types must share their functions too: numba's cache goes by the types.
    """
    functions = {name: getattr(LAWS[law], name) for name in SWITCHED}
    stepped = bench.loop_with(driven, functions, compiled)
    measured = bench.loop_with(watched, functions, compiled)
    loop = bench.loop_on_motion(stepped, measured, pushed, nothing, compiled)
    return functools.partial(run_valve, loop)


def run_valve(
    loop: Callable[..., Any],
    p: Any,
    s: Any,
    motion: CosineReference,
    valve: Valve,
    spool: Spool,
    samples: int,
) -> Outcome:
    """Run one case for so many ``samples``, or until the voltage saturates; ``spool``: where it starts."""
    parts = closed_loop.Parts(Course(motion, p.reshaping, p.period), p, valve, Watch(p, valve.b0))
    none = Outcome(math.nan, math.nan, math.nan, math.nan, math.nan, 0.0, 0.0)
    begin = closed_loop.Parts(0.0, s, spool, Seen(True, 0.0, 0.0, none))
    numbers = np.arange(samples, dtype=np.float64)
    end = loop(parts, begin, numbers, numbers, np.zeros((samples, 1)), np.zeros((0, len(s))))
    outcome: Outcome = end.measure.outcome
    return outcome


class Task(NamedTuple):
    """Work for one process: a block of cases of one law at one sample period."""

    law: str
    period: float  # s
    seed: int
    first: int
    valves: int
    duration: float  # s


def run_block(task: Task) -> Array:
    """Run a block of cases; returns their outcomes, one a row."""
    loop = loop_for(task.law)
    samples = round(task.duration / task.period)
    rows = []
    for number in range(task.first, task.first + task.valves):
        case = draw(task.seed, number)
        p, s, x1, x2 = LAWS[task.law].case(case, task.period)
        rows.append(loop(p, s, case.motion, valve_of(case, task.period), Spool(x1, x2), samples))
    return np.array(rows)


def experiment(
    valves: int = 2000,
    seed: int = 1,
    laws: Sequence[str] = tuple(LAWS),
    periods: Sequence[float] = PERIODS,
    duration: float = DURATION,
    processes: int = 1,
    progress: Progress | None = None,
) -> Experiment:
    """Test Theorems 1 A and 2 A on ``valves`` random valves per law and sample period [s].

    ``progress(done, all)`` counts blocks of runs.
    """
    firsts = range(0, valves, CHUNK)
    tasks = [
        Task(law, period, seed, first, min(CHUNK, valves - first), duration)
        for law in laws
        for period in periods
        for first in firsts
    ]
    if processes > 1:
        for law in laws:
            run_block(Task(law, periods[0], seed, 0, 1, periods[0]))  # fills numba's cache for all processes
    blocks = bench.work(run_block, tasks, processes, progress)
    kinds = np.arange(valves, dtype=np.float64) % len(KINDS)
    adaptation = np.array([draw(seed, number).adaptation for number in range(valves)])
    cells = []
    for i in range(0, len(tasks), len(firsts)):
        rows = np.concatenate(blocks[i : i + len(firsts)])
        cells.append(Cell(tasks[i].law, tasks[i].period, kinds, adaptation, *rows.T))
    return Experiment(seed, valves, duration, tuple(cells))
