# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The case of Delta Computer Systems' forum: a linear axis under pole placement, and valves before it.

The axis is G = K·ω²/(s(s² + 2ζωs + ω²)) from spool to position. Its controller places four equal poles
with a PID with second derivative, and inverts G with feedforwards of velocity, acceleration and jerk. In the
published case the spool is where it is commanded; here the valves of ``study.py`` move it.
"""

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg

from research.axes import study
from valve_control.axis import course, run
from valve_control.axis.cascade import valve_law_step
from valve_control.control import closed_loop
from valve_control.control.closed_loop import Sample
from valve_control.control.compiling import compile_function
from valve_control.control.laws import command_lead
from valve_control.control.laws.registry import LAWS
from valve_control.control.laws.signals import Start
from valve_control.control.plant import valve
from valve_control.control.plant.saturation import saturate

Array = npt.NDArray[np.float64]
PERIOD = 0.001  # s
FULL = 10.0  # V  100 % of the spool
GAIN = 0.01 * 100.0 / FULL  # m/s/V: 10 (mm/s)/%
DAMPING = 1.0 / 3.0
FREQUENCY = 2.0 * np.pi * 10.0  # rad/s
DISTANCE = 0.5  # m
LIMITS = course.MotionLimits(0.5, 2.5, 50.0)  # the jerk is not published
PAUSE, DURATION = 0.1, 2.5  # s
NONE = "none"  # the published case: no valve
VALVES = (NONE, *study.VALVES)
POLES = np.geomspace(8.0, 126.0, 13)  # rad/s  among which each valve's is sought
LEADS = tuple(range(0, 37, 4))  # periods
OFF = 0.1  # of a parameter


class Plant(NamedTuple):
    """K, ζ and ω of an axis."""

    gain: float  # m/s/V
    damping: float  # -
    frequency: float  # rad/s


NOMINAL = Plant(GAIN, DAMPING, FREQUENCY)


class AxisGains(NamedTuple):
    """Controller of the axis."""

    proportional: float  # V/m
    integral: float  # V/m/s
    derivative: float  # V·s/m
    second: float  # V·s²/m
    velocity: float  # V·s/m
    acceleration: float  # V·s²/m
    jerk: float  # V·s³/m
    period: float  # s
    limit: float  # V


class Memory(NamedTuple):
    """What the controller remembers."""

    integral: float  # m·s
    last: float  # m  error of the sample before
    older: float  # m


class Goal(NamedTuple):
    """Row of a course: where to be now, and what is fed forward."""

    position: float  # m
    velocity: float  # m/s
    acceleration: float  # m/s²
    jerk: float  # m/s³


class Axis(NamedTuple):
    """Linear axis over one period, its spool going on a straight line: x⁺ = A·x + b·begin + c·end."""

    a: Array  # (3, 3)
    begin: Array  # (3,)
    end: Array  # (3,)


class Machine(NamedTuple):
    """Valve and axis."""

    valve: valve.Params
    axis: Axis
    direct: bool  # the spool is where it is commanded


class State(NamedTuple):
    """Their states; of the axis position, velocity and acceleration."""

    valve: valve.State
    x: float
    v: float
    acceleration: float


class Tally(NamedTuple):
    """What is measured."""

    peak: float  # m
    last: float  # m  largest error within the last half second
    samples: float


class Result(NamedTuple):
    """One valve with one controller: largest errors."""

    pole: float  # rad/s
    lead: float  # s  of the feedforwards
    nominal: float  # m
    low: float  # m  with all parameters 10 % low
    corners: tuple[float, ...]  # m  at the eight corners, all low first
    restless: float  # m  largest in the last half second, at any of the nine

    @property
    def worst(self) -> float:
        """Largest error of the eight corners [m]."""
        return max(self.corners)


def gains(pole: float, p: Plant = NOMINAL) -> AxisGains:
    """Controller that places four poles at -``pole`` [rad/s] on the axis ``p`` and inverts it."""
    k = p.gain * p.frequency**2
    damped = 2.0 * p.damping * p.frequency
    return AxisGains(
        proportional=4.0 * pole**3 / k,
        integral=pole**4 / k,
        derivative=(6.0 * pole**2 - p.frequency**2) / k,
        second=(4.0 * pole - damped) / k,
        velocity=1.0 / p.gain,
        acceleration=damped / k,
        jerk=1.0 / k,
        period=PERIOD,
        limit=FULL,
    )


def discrete(p: Plant) -> Axis:
    """Exact step of the axis over a period."""
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -(p.frequency**2), -2.0 * p.damping * p.frequency]])
    big = np.zeros((5, 5))
    big[:3, :3] = a * PERIOD
    big[2, 3] = p.gain * p.frequency**2 * PERIOD
    big[3, 4] = 1.0
    whole = scipy.linalg.expm(big)
    end = np.ascontiguousarray(whole[:3, 4])
    return Axis(np.ascontiguousarray(whole[:3, :3]), np.ascontiguousarray(whole[:3, 3]) - end, end)


def step(p: AxisGains, s: Memory, goal: Goal, position: float) -> tuple[float, Memory]:
    """Spool command [V] of one sample; the integrator rests while it is at its limit."""
    e = goal.position - position
    rate = (e - s.last) / p.period
    second = (e - 2.0 * s.last + s.older) / (p.period * p.period)
    integral = s.integral + e * p.period
    wanted = p.velocity * goal.velocity + p.acceleration * goal.acceleration + p.jerk * goal.jerk
    wanted += p.proportional * e + p.integral * integral + p.derivative * rate + p.second * second
    command = saturate(wanted, p.limit)
    return command, Memory(integral if command == wanted else s.integral, e, s.last)


class Reading(NamedTuple):
    """Position of the axis and reading of the LVDT."""

    position: float  # m
    spool: float  # V


class Cascade(NamedTuple):
    """Parameters of the upper level, of the lead, and of the valve's law."""

    upper: AxisGains
    lead: command_lead.Params
    valve_law: Any
    direct: bool


class Memories(NamedTuple):
    """States of the same."""

    upper: Memory
    lead: command_lead.State
    valve_law: Any


def both(
    p: Cascade, s: Memories, goal: Goal, reading: Reading, offset: float
) -> tuple[float, Memories, Memory]:
    """One sample of both levels; returns the voltage [V] (or the spool itself), the states, the upper one."""
    command, upper = step(p.upper, s.upper, goal, reading.position)
    lead = command_lead.step(p.lead, s.lead, command)
    led = command_lead.led(p.lead, lead, command)
    voltage, law, _ = valve_law_step(p.valve_law, s.valve_law, led, reading.spool, offset)
    return command if p.direct else voltage, Memories(upper, lead, law), upper


def given_goal(params: float, state: float, given: Array) -> tuple[Goal, float]:
    """Command source: ``given`` is a row of Goal."""
    return Goal(given[0], given[1], given[2], given[3]), state


def read(p: Machine, s: State, noise: float) -> Reading:
    """Readings; that of the position is exact."""
    return Reading(s.x, valve.read(p.valve, s.valve, noise))


def move(p: Machine, s: State, voltage: float) -> State:
    """Both one period later."""
    moved = valve.step(p.valve, s.valve, voltage)
    begin, end = s.valve.x.x0, moved.x.x0
    if p.direct:
        begin = end = voltage
    a, b, c = p.axis.a, p.axis.begin, p.axis.end
    return State(
        moved,
        a[0, 0] * s.x + a[0, 1] * s.v + a[0, 2] * s.acceleration + b[0] * begin + c[0] * end,
        a[1, 0] * s.x + a[1, 1] * s.v + a[1, 2] * s.acceleration + b[1] * begin + c[1] * end,
        a[2, 0] * s.x + a[2, 1] * s.v + a[2, 2] * s.acceleration + b[2] * begin + c[2] * end,
    )


def measure(last_begin: float, s: Tally, now: Sample, plant: State) -> tuple[Tally, bool]:
    """Take in one sample; a run that has left the stroke is over."""
    error = abs(now.command.position - plant.x)
    over = not error < 2.0 * DISTANCE
    return (
        Tally(max(s.peak, error), max(s.last, error) if s.samples >= last_begin else s.last, s.samples + 1.0),
        over,
    )


def shown(plant: State, now: Sample) -> tuple[float, ...]:
    """Goal, position, spool."""
    return now.command.position, plant.x, plant.valve.x.x0


@cache
def _loop(name: str) -> Callable[..., Any]:
    law = LAWS[name].module
    one = compile_function(both, {"valve_law_step": compile_function(law.step)})
    functions: dict[str, Callable[..., Any]] = {
        "next_command": given_goal,
        "read": read,
        "measured": measure,
        "plant_step": move,
        "shown": shown,
        "law_step": one,
    }
    return closed_loop.build(functions, True, nogil=True)


@cache
def goals(lead: int) -> Array:
    """Rows of Goal of the move, 0.5 m; its feedforwards are those of ``lead`` periods later."""
    rows = course.point_to_point(0.0, [DISTANCE], PAUSE, LIMITS, PERIOD, DURATION + 0.5)
    jerk = np.gradient(rows[:, 2], PERIOD)
    n = round(DURATION / PERIOD)
    return np.column_stack(
        [rows[:n, 0], rows[lead : lead + n, 1], rows[lead : lead + n, 2], jerk[lead : lead + n]]
    )


class Case:
    """One valve before the axis."""

    def __init__(self, name: str) -> None:
        self.direct = name == NONE
        settings = study.valve_settings("servo" if self.direct else name)
        base = run.setup(settings)
        self.law = base.law
        self._base = base

    def follow(self, pole: float, lead: int, plant: Plant) -> tuple[Tally, Array]:
        """Run the move; returns what was measured, and signals (goal, position, spool)."""
        rows = goals(lead)
        law = LAWS[self.law].module
        noise = np.random.default_rng(1).standard_normal(len(rows))
        machine = Machine(self._base.machine.valve, discrete(plant), self.direct)
        rest = State(valve.initial(machine.valve), 0.0, 0.0, 0.0)
        first = read(machine, rest, noise[0])
        signals = np.zeros((len(rows), 3))
        cascade = Cascade(gains(pole), self._base.cascade.lead, self._base.cascade.valve_law, self.direct)
        begun = Memories(
            Memory(0.0, 0.0, 0.0),
            command_lead.initial(0.0),
            law.initial(cascade.valve_law, Start(first.spool, 0.0, first.spool, 0.0, 0.0)),
        )
        last_begin = float(len(rows) - round(0.5 / PERIOD))
        end = _loop(self.law)(
            closed_loop.Parts(0.0, cascade, machine, last_begin),
            closed_loop.Parts(0.0, begun, rest, Tally(0.0, 0.0, 0.0)),
            rows,
            noise,
            signals,
            np.zeros((0, 3)),
        )
        return end.measure, signals


def corners() -> list[Plant]:
    """The eight axes of which each parameter is 10 % low or high, all low first."""
    signs = itertools.product((-1.0, 1.0), repeat=3)
    return [Plant(*(v * (1.0 + OFF * s) for v, s in zip(NOMINAL, sign, strict=True))) for sign in signs]


def judge(case: Case, pole: float, lead: int) -> Result:
    """Errors of the move with the controller's poles at -``pole`` [rad/s] and ``lead`` [periods]."""
    found = [case.follow(pole, lead, plant)[0] for plant in (NOMINAL, *corners())]
    peaks = [tally.peak for tally in found]
    return Result(
        float(pole),
        lead * PERIOD,
        peaks[0],
        peaks[1],
        tuple(peaks[1:]),
        max(tally.last for tally in found),
    )


def published(case: Case) -> Result:
    """The published controller: poles at the axis's own ω, feedforwards as they are."""
    return judge(case, FREQUENCY, 0)


def best(case: Case, done: Callable[[], object] = lambda: None) -> Result:
    """The controller, of POLES and LEADS, whose largest error at the eight corners is least."""
    found = []
    for pole in POLES:
        found += [judge(case, float(pole), lead) for lead in LEADS]
        done()
    return min(found, key=lambda result: result.worst)


def study_valves(
    names: Sequence[str] = study.VALVES, done: Callable[[], object] = lambda: None
) -> dict[str, tuple[Result, Result]]:
    """By valve: with the published controller, and with its best; ``done`` is called after each of POLES."""
    cases = {name: Case(name) for name in names}
    for case in cases.values():
        case.follow(FREQUENCY, 0, NOMINAL)  # compiled in this thread, because Ctrl-C reaches no other

    def one(name: str) -> tuple[Result, Result]:
        return published(cases[name]), best(cases[name], done)

    pool = ThreadPoolExecutor(len(os.sched_getaffinity(0)))
    try:
        return dict(zip(names, pool.map(one, names), strict=True))
    finally:
        pool.shutdown(cancel_futures=True)
