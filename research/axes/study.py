# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds out what a fast valve buys: random axes under five valves, each with its largest stable gain.

Per axis and valve the proportional gain of the upper level is half of that from which a small step does not
come to rest (a gain margin of 2). With it the axis follows a motion limited in jerk, and small sines, from
which the bandwidth is found. Beside it stands how far any law could get: the amplifier's whole voltage, there
and back at each frequency, makes the largest sine that there is.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.axis import axis_arc, axis_arc_sampled, cascade, course, machine, run
from valve_control.axis import axis_parameters as parameters
from valve_control.axis.axis_parameters import AXIS, AXIS_NODES
from valve_control.control.compiling import compile_function
from valve_control.control.parameters import files, ros_file
from valve_control.parameter import Values, defaults, number, updated

Array = npt.NDArray[np.float64]
UPPER = AXIS_NODES["axis_controller"]
VALVES = ("open_loop", "pid", "oarc", "dcarc", "servo")
TUNED = {"pid": "pid_reference", "oarc": "oarc", "dcarc": "dcarc"}  # of config/tuned/narrow_0.25_*.yaml
SERVO = 2.0 * np.pi * 100.0  # rad/s  of the ideal valve, damped with 0.7
PERIOD = 0.001  # s
STEP = 0.005  # m
RESTLESS = 0.2 * STEP  # m  from peak to peak in the last half second after the step
GAINS = (1.0, 300.0)  # 1/s  between which the gain is sought
MARGIN = 2.0
SINE = 0.002  # m  amplitude of the sines, less where the speed would be
SHARE = 0.25  # of full speed that sines may take
FREQUENCIES = np.geomspace(0.5, 60.0, 22)  # Hz
SQUARE_CYCLES = 8  # of the whole voltage there and back, of which the later half counts
SQUARE_FROM = 3.0  # Hz  lowest of its frequencies: below, the piston would come to its stops
BOX = {
    "load.mass": (50.0, 400.0),
    "load.damping": (200.0, 1500.0),
    "load.coulomb": (10.0, 300.0),
    "cylinder.dead_volume_a": (5e-5, 2e-4),
    "cylinder.dead_volume_b": (5e-5, 2e-4),
    "cylinder.leakage": (1e-13, 1e-12),
    "supply.pressure": (100e5, 160e5),
}  # drawn evenly in logarithm
LIMITS = course.MotionLimits(0.25, 2.0, 40.0)
ARC: Values = {
    "upper_level": axis_arc_sampled.NAME,
    "axis_arc.learning": 2.0,
    "axis_arc.force_range": 300.0,
    "axis_arc.observer": 100.0,
    "overlap_zone": 0.2,
}  # as config/axis/bench.yaml
ARC_RATES = (1.0, 0.375, 0.25)  # -  k1, k2 and k3 of axis_arc over its gain, as there
ARC_LEADS = {"open_loop": 0.02, "servo": 0.003}  # s  valve's lag and half a period; 4 ms of the others
FASTEST = axis_arc_sampled.FASTEST / PERIOD  # 1/s  rate that axis_arc takes


class Result(NamedTuple):
    """One axis under one valve."""

    gain: float  # 1/s
    bandwidth: float  # Hz  where a small sine is at -3 dB or -90°
    motion: run.Indices
    reach: float  # Hz  where no voltage within the amplifier's limit moves the axis by that sine at -3 dB


def valve_settings(name: str) -> dict[str, Values]:
    """Settings by node of the valve ``name``, of VALVES, with its controller, under axis_pid."""
    folder = ros_file.config_folder()
    settings = run.default_settings()
    paths = [] if name == "servo" else [str(folder / "d3fxe.yaml")]
    if name in TUNED:
        paths.append(str(folder / "tuned" / f"narrow_0.25_{TUNED[name]}.yaml"))
    changes = files.given(paths, {}, [])
    if name not in TUNED:
        changes["controller"]["controller"] = "open_loop"
    if name == "servo":
        changes["valve_simulator"].update(
            valve="custom", numerator=[SERVO**2], denominator=[1.0, 1.4 * SERVO, SERVO**2]
        )
        changes["controller"]["open_loop.static_gain"] = 1.0
    for node in ("valve_simulator", "controller"):
        settings[node] = updated(AXIS_NODES[node], settings[node], changes[node])
    return settings


def random_axis(seed: int) -> Values:
    """Values of ``axis_simulator`` for the axis number ``seed``."""
    random = np.random.default_rng(seed)
    drawn: Values = {name: float(low * (high / low) ** random.random()) for name, (low, high) in BOX.items()}
    values = updated(AXIS, {p.name: p.default for p in AXIS}, drawn)
    overlap = float(random.uniform(0.0, 0.05))
    area_a, area_b, tank, a = 1.257e-3, 7.66e-4, 1e5, 30e5
    return updated(
        AXIS,
        values,
        {
            "cylinder.area_a": area_a,
            "cylinder.area_b": area_b,
            "spool.overlap": [overlap] * 4,
            "start.position": float(random.uniform(0.15, 0.3)),
            "start.pressure_a": a,
            "start.pressure_b": (a * area_a - tank * (area_a - area_b)) / area_b,
            "load.static_ratio": 1.4,
            "position.resolution": 5e-6,
            "seed": seed,
        },
    )


class Axis:
    """One random axis under one valve, whose gain and course can be changed."""

    def __init__(self, base: run.Setup, values: Values) -> None:
        axis = parameters.axis_params(values)
        plant = base.machine._replace(axis=axis, sensors=parameters.sensors(values))
        out, into = parameters.velocity_gains(axis, values)
        overlap = 0.8 * axis.overlaps.pa * axis.full_scale  # what its user knows of it
        if base.level == axis_arc_sampled.NAME:
            model = axis_arc_sampled.model_of(axis, parameters.supply_pressure(values))
            stiffness = axis_arc.stiffness(model, 0.5 * model.stroke)
            own = math.sqrt(axis.bulk_modulus * (1.0 / axis.load.mass) * stiffness)
            changes: Values = {"overlap": overlap, "axis_arc.coupling": min(own, FASTEST)}
            changes["axis_arc.lead"] = base.cascade.upper.lead
            level = updated(UPPER, defaults(UPPER), {**ARC, **changes})
            upper = parameters.upper_level(level, axis, values)
        else:
            upper = base.cascade.upper._replace(gain_out=out, gain_in=into, overlap=overlap)
        self.at = number(values, "start.position")
        self.speed = min(out, into) * axis.full_scale
        self._setup = base._replace(
            machine=plant,
            begin=parameters.start(plant, values),
            cascade=base.cascade._replace(upper=upper),
            seed=int(number(values, "seed")),
        )

    def driven(self, voltages: Array) -> Array:
        """True position [m] at each sample, with ``voltages`` [V] on the valve and no controller."""
        out = np.empty(len(voltages))
        compile_function(drive)(self._setup.machine, machine.copied(self._setup.begin), voltages, out)
        return out

    def follow(self, gain: float, goals: Array) -> tuple[run.Indices, Array]:
        """Indices and true position [m] with the ``gain`` [1/s] on a course."""
        upper = self._setup.cascade.upper
        if self._setup.level == axis_arc_sampled.NAME:
            k1, k2, k3 = (min(gain * rate, FASTEST) for rate in ARC_RATES)
            upper = upper._replace(law=upper.law._replace(k1=k1, k2=k2, k3=k3))
        else:
            upper = upper._replace(kp=gain)
        setup = self._setup._replace(cascade=self._setup.cascade._replace(upper=upper), goals=goals)
        signals = np.empty((len(goals), len(cascade.SIGNALS)))
        return run.indices_of(setup, signals), signals[:, cascade.SIGNALS.index("position")]


def drive(p: machine.Params, s: machine.State, voltages: Array, out: Array) -> None:
    """Write into ``out`` the positions [m] of a machine under ``voltages`` [V]."""
    for k in range(len(voltages)):
        out[k] = s.axis.x
        s = machine.step(p, s, voltages[k])


def sine_amplitude(speed: float, f: float) -> float:
    """Amplitude [m] of the sine of ``f`` [Hz] that an axis of that ``speed`` [m/s] is asked for."""
    return min(SINE, SHARE * speed / (2.0 * np.pi * f))


def reach(axis: Axis, u_max: float) -> float:
    """Frequency [Hz] from which no voltage within ±``u_max`` [V] moves the axis by the study's sine at -3 dB.

    Of all bounded voltages the square wave has the largest fundamental, 4/π·u_max; what it makes of the
    position is compared. Neither stability nor phase is asked for.
    """
    before = (SQUARE_FROM, np.inf)
    for f in FREQUENCIES[FREQUENCIES >= SQUARE_FROM]:
        n = round(SQUARE_CYCLES / f / PERIOD)
        t = np.arange(n) * PERIOD
        x = axis.driven(np.where((t + 0.5 * PERIOD) * f % 1.0 < 0.5, u_max, -u_max))
        late = slice(n - round(SQUARE_CYCLES / 2.0 / f / PERIOD), n)
        x = x[late] - np.polyval(np.polyfit(t[late], x[late], 1), t[late])  # without the drift
        size = 2.0 * abs(np.mean(x * np.exp(-2j * np.pi * f * t[late])))
        left = np.log(size / (np.sqrt(0.5) * sine_amplitude(axis.speed, f)))
        if left <= 0.0:
            share = before[1] / (before[1] - left) if np.isfinite(before[1]) else 0.0
            return float(before[0] * (f / before[0]) ** share)
        before = (f, left)
    return float(FREQUENCIES[-1])


def largest_gain(axis: Axis) -> float:
    """Gain [1/s] from which a small step does not come to rest, within 2 %."""
    goals = np.zeros((1500, 3))
    goals[:, 0] = axis.at + STEP
    low, high = GAINS
    while high > 1.02 * low:
        gain = float(np.sqrt(low * high))
        _, x = axis.follow(gain, goals)
        if np.ptp(x[-500:]) > RESTLESS:
            high = gain
        else:
            low = gain
    return low


def bandwidth(axis: Axis, gain: float) -> float:
    """Frequency [Hz] at which a small sine is at -3 dB or -90°, whichever is first."""
    before = (FREQUENCIES[0], 1.0)
    for f in FREQUENCIES:
        amplitude = sine_amplitude(axis.speed, f)
        cycles = max(3, round(f))
        rise = 2.0 * min(0.5, 1.0 / f) + 0.25
        goals = course.sine(axis.at, amplitude, f, PERIOD, rise + cycles / f)
        _, x = axis.follow(gain, goals)
        n = round(cycles / f / PERIOD)
        turn = np.exp(-2j * np.pi * f * np.arange(len(x)) * PERIOD)[-n:]
        answer = np.sum((x[-n:] - np.mean(x[-n:])) * turn) / np.sum((goals[-n:, 0] - axis.at) * turn)
        # 1 at 0 dB and 0°, 0 at -3 dB or -90°.
        left = min(
            (abs(answer) - np.sqrt(0.5)) / (1.0 - np.sqrt(0.5)), 1.0 + np.angle(answer) / (0.5 * np.pi)
        )
        if left <= 0.0:
            share = before[1] / (before[1] - left)
            return float(before[0] * (f / before[0]) ** share)
        before = (f, left)
    return float(FREQUENCIES[-1])


def judge(base: run.Setup, values: Values) -> Result:
    """Result of one axis under one valve."""
    axis = Axis(base, values)
    gain = largest_gain(axis) / MARGIN
    goals = course.point_to_point(axis.at, [axis.at + 0.1, axis.at], 0.3, LIMITS, PERIOD, 2.5)
    motion = axis.follow(gain, goals)[0]
    return Result(gain, bandwidth(axis, gain), motion, reach(axis, base.machine.valve.u_max))


def base_of(name: str, level: str) -> run.Setup:
    """The cascade of the valve ``name`` under the upper ``level``, above an axis that is to be replaced."""
    settings = valve_settings(name)
    if level == axis_arc_sampled.NAME:
        lead = ARC_LEADS.get(name, 0.004)
        changes: Values = {**ARC, "axis_arc.lead": lead}
        settings["axis_controller"] = updated(UPPER, settings["axis_controller"], changes)
    return run.setup(settings)


def study(
    axes: int,
    threads: int | None = None,
    done: Callable[[], object] = lambda: None,
    level: str = "axis_pid",
) -> dict[str, list[Result]]:
    """Results by valve of the axes 0 to ``axes`` - 1; ``done`` is called after each axis under a valve."""
    bases = {name: base_of(name, level) for name in VALVES}
    for base in bases.values():
        run.indices_of(base._replace(goals=base.goals[:1]), np.empty((1, len(cascade.SIGNALS))))  # compiles
        Axis(base, random_axis(0)).driven(np.zeros(1))
    drawn = [random_axis(seed) for seed in range(axes)]

    def one(job: tuple[str, Values]) -> Result:
        result = judge(bases[job[0]], job[1])
        done()
        return result

    pool = ThreadPoolExecutor(threads or len(os.sched_getaffinity(0)))
    try:
        found = list(pool.map(one, [(name, values) for name in VALVES for values in drawn]))
    finally:
        pool.shutdown(cancel_futures=True)
    return {name: found[i * axes : (i + 1) * axes] for i, name in enumerate(VALVES)}
