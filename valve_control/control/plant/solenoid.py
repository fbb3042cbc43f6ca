# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates one sample of a valve with proportional solenoids as a pure step.

docs/explanation/valve_model.md derives it.

Amplifier, coil, magnet with hysteresis, spool with friction and stops, and LVDT, in volts of LVDT signal like
the linear valve of ``valve``. The voltage is held over the sample, which is divided into substeps. Over each
of them coil and spool are advanced by exact transition matrices, and bristles and velocity are solved
together, implicitly, in closed form: no substep has to be as short as the time in which bristles straighten.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.control.plant import valve
from valve_control.control.plant.sensor import Lvdt, reading
from valve_control.control.plant.valve import Row

LONGEST = 1e-4  # s  of a substep
COIL = 0.2  # of the coil's lag that a substep lasts at most
ANGLE = 0.1  # rad  by which the spool, held by its bristles, swings in a substep at most
DITHER = 0.2  # rad  by which the dither goes on in a substep at most


class Amplifier(NamedTuple):
    """From the voltage that is asked for to that on the coil."""

    u_min: float  # V
    dead_time: float  # periods
    dither: float  # V  amplitude of the sine that is added
    dither_rate: float  # rad/s


class Magnet(NamedTuple):
    """From the voltage on the coil to the force, as the voltage that makes it at rest."""

    coil: float  # s  L/R
    eddy: float  # s  second lag, by eddy currents; 0: none
    hysteresis: float  # V  full width of the loop
    positive: float  # -  gain of the side that pushes the spool to positive positions
    negative: float  # -  of the other
    overlap: float  # V  voltage from which on a side acts; below 0: both act around 0 V
    gain_drift: float  # 1/s  relative growth of both gains


class Spool(NamedTuple):
    """Mass on a spring."""

    natural_frequency: float  # rad/s  without flow force
    damping: float  # -
    gain: float  # V/V  static
    flow_force: float  # V/V  force against the position
    offset: float  # V  constant force
    stiffness_drift: float  # V/V/s  growth of the flow force
    low: float  # V  stop
    high: float  # V  stop


class Friction(NamedTuple):
    """Bristles of LuGre (Canudas de Wit et al. 1995), as voltage at the input."""

    coulomb: float  # V  0: no friction
    static: float  # V  added to it at standstill
    stribeck_velocity: float  # V/s
    stiffness: float  # V/V  of the bristles, σ0
    damping: float  # V·s/V  of the bristles, σ1


class Sensor(NamedTuple):
    """LVDT with its converter."""

    lvdt: Lvdt
    low: float  # V  range of the converter
    high: float  # V
    hum: float  # V  amplitude
    hum_rate: float  # rad/s
    null_drift: float  # V  in the end, when warm
    warming_time: float  # s


class Substep(NamedTuple):
    """Coefficients of one substep."""

    number: float  # in a period, a whole number
    length: float  # s
    current: float  # -  what is left of a difference of the current
    force: float  # -  what is left of a difference of the force
    through: float  # -  what a difference of the current adds to the force
    x_x: float  # transition of position and velocity
    x_v: float  # s
    v_x: float  # 1/s
    v_v: float
    x_force: float  # V/V
    v_force: float  # V/s/V


class Params(NamedTuple):
    """One valve at one sample period."""

    amplifier: Amplifier
    magnet: Magnet
    spool: Spool
    friction: Friction
    sensor: Sensor
    substep: Substep
    u_max: float  # V  upper limit of the amplifier
    period: float  # s  ΔT


class State(NamedTuple):
    """State of a valve. ``history`` is a ring of past samples and is overwritten in place.

    Each of its rows holds what a row of ``valve.State`` holds, and the voltage [V] from that sample on.
    """

    x: Row  # position [V], velocity [V/s], force of the magnet before its hysteresis [V], current [V]
    play: float  # V  force behind the hysteresis
    bristle: float  # V  deflection
    time: float  # s
    history: npt.NDArray[np.float64]  # V, (samples, 3)
    newest: int  # index into history


class SubstepMean(NamedTuple):
    """Mean of a substep."""

    velocity: float  # V/s
    friction: float  # V
    bristle: float  # V  deflection at its end


def substep(
    magnet: Magnet, spool: Spool, friction: Friction, dither_rate: float, period: float, finer: int
) -> Substep:
    """Coefficients of substeps that are short enough, times 1/``finer``, at a ``period`` [s]."""
    import scipy.linalg  # takes a while

    held = spool.gain * (spool.flow_force + friction.stiffness)
    fastest = spool.natural_frequency * math.sqrt(max(1.0, 1.0 + held))
    longest = min(LONGEST, COIL * magnet.coil, ANGLE / fastest)
    if dither_rate > 0.0:
        longest = min(longest, DITHER / dither_rate)
    number = finer * math.ceil(period / longest * (1.0 - 1e-9))
    h = period / number
    current = math.exp(-h / magnet.coil)
    force = math.exp(-h / magnet.eddy) if magnet.eddy > 0.0 else 0.0
    apart = magnet.coil - magnet.eddy
    if abs(apart) > 1e-6 * magnet.coil:
        through = magnet.coil * (current - force) / apart
    else:
        through = h / magnet.coil * current
    square = spool.natural_frequency**2
    a = np.zeros((3, 3))
    a[0, 1] = 1.0
    a[1] = (
        -square * (1.0 + spool.gain * spool.flow_force),
        -2.0 * spool.damping * spool.natural_frequency,
        square * spool.gain,
    )
    moved = scipy.linalg.expm(a * h)
    return Substep(
        float(number),
        h,
        current,
        force,
        through,
        float(moved[0, 0]),
        float(moved[0, 1]),
        float(moved[1, 0]),
        float(moved[1, 1]),
        float(moved[0, 2]),
        float(moved[1, 2]),
    )


def design(
    amplifier: Amplifier,
    magnet: Magnet,
    spool: Spool,
    friction: Friction,
    sensor: Sensor,
    u_max: float,
    period: float,
    finer: int = 1,
) -> Params:
    """Valve at one sample ``period`` [s].

    ``u_max``: upper limit of the amplifier [V]; ``finer``: substeps for one that is short enough.
    """
    rate = amplifier.dither_rate if amplifier.dither > 0.0 else 0.0
    made = substep(magnet, spool, friction, rate, period, finer)
    return Params(amplifier, magnet, spool, friction, sensor, made, u_max, period)


def initial(p: Params) -> State:
    """Spool at rest in the centre, no voltage."""
    length = int(max(p.sensor.lvdt.delay, p.amplifier.dead_time)) + 2
    return State(Row(0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, np.zeros((length, 3)), 0)


def standing(p: Params, position: float, voltage: float) -> State:
    """Spool at rest at ``position`` [V] under ``voltage`` [V], where friction holds it as far as it can.

    The force is in the middle of its hysteresis, of which a standing spool does not tell the side.
    """
    state, f = initial(p), p.friction
    given = limited(voltage, p.amplifier.u_min, p.u_max)
    bristle = 0.0
    if f.coulomb > 0.0:
        level = friction_level(f, 0.0)
        needed = position * (1.0 / p.spool.gain + p.spool.flow_force)
        bristle = limited(pull(p.magnet, given) + p.spool.offset - needed, -level, level) / f.stiffness
    state.history[:, :2] = position
    state.history[:, 2] = given
    return state._replace(x=Row(position, 0.0, given, given), play=given, bristle=bristle)


def limited(number: float, low: float, high: float) -> float:
    """``number`` between ``low`` and ``high``."""
    if number > high:
        return high
    if number < low:
        return low
    return number


def pull(m: Magnet, voltage: float) -> float:
    """Static force [V] of both sides at a ``voltage`` [V] behind the hysteresis."""
    force = 0.0
    if voltage > m.overlap:
        force += m.positive * (voltage - m.overlap)
    if -voltage > m.overlap:
        force += m.negative * (voltage + m.overlap)
    return force


def friction_level(f: Friction, velocity: float) -> float:
    """Level of friction [V] while sliding at ``velocity`` [V/s]: Coulomb's with Stribeck's addition."""
    ratio = velocity / f.stribeck_velocity
    return f.coulomb + f.static * math.exp(-ratio * ratio)


def rub(f: Friction, h: float, mobility: float, bristle: float, free: float, before: float) -> SubstepMean:
    """Mean velocity, mean friction and bristles over a substep of ``h`` [s], from those of before.

    ``free``: mean velocity [V/s] without friction, of which 1 V of friction takes ``mobility`` [V/s/V];
    ``before``: velocity [V/s] at which level and weight of the bristles' rate are taken.

    The bristles' rate dz/dt = v - |v|·z·σ0/g holds in the mean of the substep with z̄ = z + θ·(z⁺ - z). The
    weight θ is that of the exact solution at constant velocity, 1/(1 - exp(-q)) - 1/q with q = h·|v|·σ0/g, in
    its rational approximation (3 + q)/(6 + q). With v = ``free`` - ``mobility``·(σ0·z̄ + σ1·dz/dt) the speed
    is the one positive root of a quadratic equation.
    """
    level = friction_level(f, before)
    rate = f.stiffness * h / level
    weight = (3.0 + rate * abs(before)) / (6.0 + rate * abs(before))
    stiffness, damping = mobility * f.stiffness, mobility * f.damping
    moving = free - stiffness * bristle
    sign = math.copysign(1.0, moving)
    a = weight * rate
    b = 1.0 + damping + stiffness * weight * h - sign * (a * free + damping * f.stiffness / level * bristle)
    root = math.sqrt(b * b + 4.0 * a * abs(moving))
    speed = 2.0 * abs(moving) / (b + root) if b > 0.0 else 0.5 * (root - b) / a
    return dragged(f, h, bristle, sign * speed, rate, weight)


def dragged(
    f: Friction, h: float, bristle: float, velocity: float, rate: float, weight: float
) -> SubstepMean:
    """Motion of a substep with a mean ``velocity`` [V/s]; ``rate`` and ``weight`` as in ``rub``."""
    mean = (bristle + weight * h * velocity) / (1.0 + weight * rate * abs(velocity))
    following = bristle + h * velocity - rate * abs(velocity) * mean
    friction = f.stiffness * mean + f.damping * (following - bristle) / h
    return SubstepMean(velocity, friction, following)


def stopped(f: Friction, h: float, bristle: float, velocity: float) -> float:
    """Deflection [V] of bristles after a substep that a stop ends, with a mean ``velocity`` [V/s]."""
    rate = f.stiffness * h / friction_level(f, velocity)
    weight = (3.0 + rate * abs(velocity)) / (6.0 + rate * abs(velocity))
    return dragged(f, h, bristle, velocity, rate, weight).bristle


def shifted(p: Params, x: Row, bristle: float, force: float) -> tuple[float, float, float]:
    """Position [V], velocity [V/s] and bristles [V] after a substep with a mean ``force`` [V]."""
    s, f, h = p.substep, p.friction, p.substep.length
    position = s.x_x * x.x0 + s.x_v * x.x1 + s.x_force * force
    velocity = s.v_x * x.x0 + s.v_v * x.x1 + s.v_force * force
    if f.coulomb > 0.0:
        mobility = s.x_force / h
        free = (position - x.x0) / h
        first = rub(f, h, mobility, bristle, free, x.x1)
        moved = rub(f, h, mobility, bristle, free, first.velocity)
        position = x.x0 + h * moved.velocity
        velocity -= s.v_force * moved.friction
        following = moved.bristle
    else:
        following = 0.0
    if position > p.spool.high or position < p.spool.low:
        position = limited(position, p.spool.low, p.spool.high)
        velocity = 0.0
        if f.coulomb > 0.0:
            following = stopped(f, h, bristle, (position - x.x0) / h)
    return position, velocity, following


def held(p: Params, history: npt.NDArray[np.float64], newest: int, i: int) -> float:
    """Mean of the voltage [V] that arrives at the amplifier in substep ``i`` of the ``newest`` sample."""
    whole = int(p.amplifier.dead_time)
    n = len(history)
    voltage = float(history[(newest - whole) % n, 2])
    older = limited((p.amplifier.dead_time - whole) * p.substep.number - i, 0.0, 1.0)
    if older > 0.0:
        voltage += older * (float(history[(newest - whole - 1) % n, 2]) - voltage)
    return voltage


def advance(
    p: Params, x: Row, play: float, bristle: float, voltage: float, time: float
) -> tuple[Row, float, float]:
    """Row of ``State``, force behind the hysteresis and bristles after a substep that begins at ``time`` [s].

    ``voltage`` [V]: of ``held``.
    """
    s, m = p.substep, p.magnet
    middle = time + 0.5 * s.length
    if p.amplifier.dither > 0.0:
        voltage += p.amplifier.dither * math.sin(p.amplifier.dither_rate * middle)
    voltage = limited(voltage, p.amplifier.u_min, p.u_max)
    force = voltage + s.force * (x.x2 - voltage) + s.through * (x.x3 - voltage)
    current = voltage + s.current * (x.x3 - voltage)
    following = limited(play, force - 0.5 * m.hysteresis, force + 0.5 * m.hysteresis)
    mean = 0.5 * (pull(m, play) + pull(m, following)) * max(0.0, 1.0 + m.gain_drift * middle)
    drift = p.spool.stiffness_drift * middle * (x.x0 + 0.5 * s.length * x.x1)
    position, velocity, bristle = shifted(p, x, bristle, mean + p.spool.offset - drift)
    return Row(position, velocity, force, current), following, bristle


def step(p: Params, s: State, voltage: float) -> State:
    """State of the valve one period later, with ``voltage`` [V] held over it."""
    s.history[s.newest, 2] = voltage
    x, play, bristle = s.x, s.play, s.bristle
    for i in range(int(p.substep.number)):
        given = held(p, s.history, s.newest, i)
        x, play, bristle = advance(p, x, play, bristle, given, s.time + i * p.substep.length)
    newest = (s.newest + 1) % len(s.history)
    valve.remember(s.history, newest, x, p.period)
    return State(x, play, bristle, s.time + p.period, s.history, newest)


def read(p: Params, s: State, noise: float) -> float:
    """Reading [V] of LVDT and converter at this sample; ``noise`` is a standard normal number."""
    e = p.sensor
    position = valve.delayed(e.lvdt.delay, s.history, s.newest) if e.lvdt.delay > 0.0 else s.x.x0
    if e.hum > 0.0:
        position += e.hum * math.sin(e.hum_rate * s.time)
    if e.null_drift != 0.0:
        position += e.null_drift * (1.0 - math.exp(-s.time / e.warming_time))
    return limited(reading(e.lvdt, position, noise), e.low, e.high)
