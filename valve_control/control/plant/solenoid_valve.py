# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes the valve with proportional solenoids as a plant: its parameters and its linear form."""

import math
from collections.abc import Mapping

import numpy as np

from valve_control.control.plant import sensor, solenoid, valve
from valve_control.control.plant.plant import Plant
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.parameter import Parameter, ParameterError, Table, Value, Values, number

CONVERTER = 10.0  # V  range of the converter to both sides
NEVER = 1e9  # V  range of a reading without converter

PARAMETERS: Table = (
    Parameter(
        "solenoid.u_min", -10.0, "V", "lower limit of the amplifier; u_max is the upper one", -100.0, 100.0
    ),
    Parameter("solenoid.dead_time", 0.0, "s", "dead time of bus and amplifier before the coil", 0.0, 1.0),
    Parameter("solenoid.dither", 0.0, "V", "amplitude of the sine that the amplifier adds", 0.0, 10.0),
    Parameter("solenoid.dither_frequency", 150.0, "Hz", "frequency of the dither", 1.0, 1e4),
    Parameter("solenoid.coil", 0.003, "s", "lag L/R of the coil's current behind the voltage", 1e-4, 1.0),
    Parameter(
        "solenoid.eddy", 0.0, "s", "lag of the force behind the current, by eddy currents; 0: none", 0.0, 1.0
    ),
    Parameter(
        "solenoid.hysteresis",
        0.0,
        "V",
        "full width of the magnet's hysteresis loop, as input voltage",
        0.0,
        100.0,
    ),
    Parameter("solenoid.gain", 0.9, "V/V", "static gain from voltage to position", 0.001, 1000.0),
    Parameter(
        "solenoid.positive",
        1.0,
        "-",
        "factor of the gain of the side that acts to positive positions",
        0.01,
        100.0,
    ),
    Parameter("solenoid.negative", 1.0, "-", "factor of the gain of the other side", 0.01, 100.0),
    Parameter(
        "solenoid.overlap",
        0.0,
        "V",
        "voltage from which each side acts (dead zone); below 0: underlap, both sides act around 0 V",
        -10.0,
        10.0,
    ),
    Parameter("solenoid.natural_frequency", 15.0, "Hz", "natural frequency of spool and spring", 0.1, 3000.0),
    Parameter("solenoid.damping", 0.8, "-", "viscous damping ratio of spool and spring", 0.001, 100.0),
    Parameter(
        "solenoid.bristle_damping", 0.0, "V·s/V", "damping of friction's bristles (σ1 of LuGre)", 0.0, 100.0
    ),
    Parameter(
        "solenoid.pressure", 35.0, "bar", "pressure difference over the edges of the spool", 0.0, 1000.0
    ),
    Parameter("solenoid.rated_pressure", 35.0, "bar", "pressure difference of flow_force", 0.1, 1000.0),
    Parameter("solenoid.stop_low", -10.5, "V", "position of the lower stop", -1000.0, 0.0),
    Parameter("solenoid.stop_high", 10.5, "V", "position of the upper stop", 0.0, 1000.0),
    Parameter(
        "solenoid.bits",
        0,
        "",
        "bits of the converter of the reading over ±10 V; 0: lvdt.resolution applies",
        0,
        24,
    ),
    Parameter("solenoid.hum", 0.0, "V", "amplitude of the mains' hum in the reading", 0.0, 10.0),
    Parameter("solenoid.hum_frequency", 50.0, "Hz", "frequency of the hum", 1.0, 1e4),
    Parameter("solenoid.null_drift", 0.0, "V/K", "drift of the reading with temperature", -1.0, 1.0),
    Parameter("solenoid.warming", 0.0, "K", "temperature rise of the LVDT", -200.0, 200.0),
    Parameter("solenoid.warming_time", 300.0, "s", "time constant of the warming", 0.001, 1e6),
)


def _check(values: Values) -> None:
    """Raise ParameterError for numbers that contradict each other."""
    u_min, u_max = number(values, "solenoid.u_min"), number(values, "u_max")
    if u_min >= u_max:
        raise ParameterError(f"solenoid.u_min is {u_min:g} V; it must lie below u_max, {u_max:g} V")
    low, high = number(values, "solenoid.stop_low"), number(values, "solenoid.stop_high")
    if low >= high:
        raise ParameterError(
            f"solenoid.stop_low is {low:g} V; it must lie below solenoid.stop_high, {high:g} V"
        )
    gain = number(values, "solenoid.gain") * number(values, "gain_scale")
    width, stroke = number(values, "solenoid.hysteresis"), (high - low) / gain
    if width >= stroke:
        raise ParameterError(
            f"solenoid.hysteresis is {width:g} V; it must be narrower than the {stroke:.4g} V of the stroke"
        )
    overlap = number(values, "solenoid.overlap")
    if overlap >= max(u_max, -u_min):
        raise ParameterError(
            f"solenoid.overlap is {overlap:g} V; it must lie below the limit of the amplifier, "
            f"{max(u_max, -u_min):g} V, or the spool never moves"
        )
    if number(values, "friction.coulomb") > 0.0 and number(values, "friction.presliding") == 0.0:
        raise ParameterError(
            "friction.presliding is 0 V; the friction of the solenoid valve needs more, such as 0.01 V"
        )
    if number(values, "solenoid.bits") > 0.0 and number(values, "lvdt.resolution") > 0.0:
        raise ParameterError(
            "solenoid.bits and lvdt.resolution both give the step of the reading; set one to 0"
        )
    if 1.0 + gain * _flow_force(values) <= 0.0:
        raise ParameterError(
            f"flow_force is {_flow_force(values):g} V/V at solenoid.pressure; it must lie above "
            f"{-1.0 / gain:.4g} V/V, or the spool runs away"
        )


def _flow_force(values: Values) -> float:
    share = number(values, "solenoid.pressure") / number(values, "solenoid.rated_pressure")
    return number(values, "flow_force") * share


def _spool(values: Values) -> solenoid.Spool:
    return solenoid.Spool(
        natural_frequency=2.0 * math.pi * number(values, "solenoid.natural_frequency"),
        damping=number(values, "solenoid.damping"),
        gain=number(values, "solenoid.gain") * number(values, "gain_scale"),
        flow_force=_flow_force(values),
        offset=number(values, "disturbance.offset"),
        stiffness_drift=number(values, "drift.stiffness"),
        low=number(values, "solenoid.stop_low"),
        high=number(values, "solenoid.stop_high"),
    )


def _friction(values: Values) -> solenoid.Friction:
    coulomb, presliding = number(values, "friction.coulomb"), number(values, "friction.presliding")
    return solenoid.Friction(
        coulomb=coulomb,
        static=(number(values, "friction.static_ratio") - 1.0) * coulomb,
        stribeck_velocity=number(values, "friction.stribeck_velocity"),
        stiffness=coulomb / presliding if coulomb > 0.0 else 0.0,
        damping=number(values, "solenoid.bristle_damping"),
    )


def _sensor(values: Values) -> solenoid.Sensor:
    own, bits = sensor.build(values), int(number(values, "solenoid.bits"))
    low, high = -NEVER, NEVER
    if bits > 0:
        own = own._replace(resolution=2.0 * CONVERTER / 2**bits)
        low, high = -CONVERTER, CONVERTER - own.resolution
    return solenoid.Sensor(
        lvdt=own,
        low=low,
        high=high,
        hum=number(values, "solenoid.hum"),
        hum_rate=2.0 * math.pi * number(values, "solenoid.hum_frequency"),
        null_drift=number(values, "solenoid.null_drift") * number(values, "solenoid.warming"),
        warming_time=number(values, "solenoid.warming_time"),
    )


def build(values: Values, finer: int = 1) -> solenoid.Params:
    """Valve from the simulator's values; ``finer``: substeps for one. Raises ParameterError."""
    _check(values)
    period = number(values, "sample_period")
    amplifier = solenoid.Amplifier(
        u_min=number(values, "solenoid.u_min"),
        dead_time=number(values, "solenoid.dead_time") / period,
        dither=number(values, "solenoid.dither"),
        dither_rate=2.0 * math.pi * number(values, "solenoid.dither_frequency"),
    )
    magnet = solenoid.Magnet(
        coil=number(values, "solenoid.coil"),
        eddy=number(values, "solenoid.eddy"),
        hysteresis=number(values, "solenoid.hysteresis"),
        positive=number(values, "solenoid.positive"),
        negative=number(values, "solenoid.negative"),
        overlap=number(values, "solenoid.overlap"),
        gain_drift=number(values, "drift.gain"),
    )
    parts = (amplifier, magnet, _spool(values), _friction(values), _sensor(values))
    return solenoid.design(*parts, number(values, "u_max"), period, finer)


def transfer(magnet: solenoid.Magnet, spool: solenoid.Spool) -> TransferFunction:
    """From voltage to position, with the mean of both gains, without hysteresis, overlap and flow force."""
    omega = spool.natural_frequency
    denominator = np.array([1.0, 2.0 * spool.damping * omega, omega * omega])
    gain = 0.5 * (magnet.positive + magnet.negative) * spool.gain * omega * omega
    for lag in (magnet.coil, magnet.eddy):
        if lag > 0.0:
            denominator = np.polymul(denominator, [1.0, 1.0 / lag])
            gain /= lag
    return TransferFunction((gain,), tuple(float(c) for c in denominator))


def model(values: Values) -> TransferFunction:
    """Linear model of the valve for small motions. Raises ParameterError."""
    made = build(values)
    return transfer(made.magnet, made.spool)


def linear(params: solenoid.Params) -> valve.Params:
    """Linear valve that it is like for small motions, with all dead time in its LVDT."""
    spool, f, magnet = params.spool, params.friction, params.magnet
    acting = 2.0 if magnet.overlap < 0.0 else 1.0  # underlap: both sides act around 0 V
    side = 0.5 * acting * (magnet.positive + magnet.negative)  # force per voltage behind the hysteresis
    d = valve.Disturbance(
        coulomb=f.coulomb / side,
        static_ratio=1.0 + f.static / f.coulomb if f.coulomb > 0.0 else 1.0,
        stribeck_velocity=f.stribeck_velocity,
        velocity_scale=1.0,
        presliding=f.coulomb / f.stiffness if f.coulomb > 0.0 else 0.0,
        flow_force=0.0,
        offset=spool.offset / side,
        stiffness_drift=spool.stiffness_drift / side,
        gain_drift=magnet.gain_drift,
    )
    delay = params.sensor.lvdt.delay + params.amplifier.dead_time
    # With flow force the spring is stiffer: 1 + K·k_f, in which the gain of the coil's voltage has no part.
    stiff = 1.0 + spool.gain * spool.flow_force
    root = math.sqrt(stiff)
    with_flow = spool._replace(
        natural_frequency=root * spool.natural_frequency,
        damping=spool.damping / root,
        gain=spool.gain / stiff,
    )
    made = transfer(magnet, with_flow).scaled(acting)
    own = params.sensor.lvdt._replace(delay=delay)
    return valve.design(made, params.period, params.u_max, 1.0, d, own)


def pull(params: solenoid.Params, voltage: float) -> float:
    """Force [V] at rest of a ``voltage`` [V], where ``linear`` has the voltage itself; without hysteresis."""
    m = params.magnet
    sides = 2.0 if m.overlap < 0.0 else 1.0
    return solenoid.pull(m, voltage) / (0.5 * sides * (m.positive + m.negative))


def scaled(values: Values, gain: float, speed: float) -> Mapping[str, Value]:
    """Changed values of a valve with its gain and the speed of its poles multiplied."""
    return {
        "solenoid.gain": gain * number(values, "solenoid.gain"),
        "solenoid.natural_frequency": speed * number(values, "solenoid.natural_frequency"),
        "solenoid.coil": number(values, "solenoid.coil") / speed,
        "solenoid.eddy": number(values, "solenoid.eddy") / speed,
    }


def varied(params: solenoid.Params, gain: float, later: float, friction: float) -> solenoid.Params:
    """Valve with ``gain`` times the gain, ``later`` periods more of dead time, a share ``friction`` of it."""
    f, own = params.friction, params.sensor.lvdt
    return solenoid.design(
        params.amplifier,
        params.magnet,
        params.spool._replace(gain=gain * params.spool.gain),
        f._replace(
            coulomb=friction * f.coulomb, static=friction * f.static, stiffness=friction * f.stiffness
        ),
        params.sensor._replace(lvdt=own._replace(delay=own.delay + later)),
        params.u_max,
        params.period,
    )


def quiet(params: solenoid.Params) -> solenoid.Params:
    """Valve without noise and hum."""
    own = params.sensor.lvdt._replace(noise=0.0)
    return params._replace(sensor=params.sensor._replace(lvdt=own, hum=0.0))


def steady(params: solenoid.Params) -> solenoid.Params:
    """Valve without drift."""
    return params._replace(
        magnet=params.magnet._replace(gain_drift=0.0),
        spool=params.spool._replace(stiffness_drift=0.0),
        sensor=params.sensor._replace(null_drift=0.0),
    )


def resumed(former: solenoid.Params, params: solenoid.Params, state: solenoid.State) -> solenoid.State:
    """State that goes on under ``params``; with other dead times, spool and voltage have stood still."""
    times = [(p.sensor.lvdt.delay, p.amplifier.dead_time) for p in (former, params)]
    if times[0] == times[1]:
        return state
    history = solenoid.initial(params).history
    history[:, :2] = state.x.x0
    history[:, 2] = state.history[(state.newest - 1) % len(state.history), 2]
    return state._replace(history=history, newest=0)


PLANT = Plant(
    name="solenoid",
    text="valve with proportional solenoids: coil, hysteresis, spool with LuGre friction, amplifier and LVDT",
    module=solenoid,
    parameters=PARAMETERS,
    build=build,
    model=model,
    linear=linear,
    scaled=scaled,
    varied=varied,
    quiet=quiet,
    steady=steady,
    resumed=resumed,
    pull=pull,
)
