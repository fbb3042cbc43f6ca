# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Describes the paper's valve as a plant: models (2), (3) or a custom one, with disturbances at the input."""

from collections.abc import Mapping
from typing import Any

from valve_control.control.plant import sensor, transfer_functions, valve
from valve_control.control.plant.plant import Plant
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.parameter import ParameterError, Value, Values, number


def build(values: Values) -> valve.Params:
    """Valve from the simulator's values. Raises ParameterError."""
    disturbance = valve.Disturbance(
        coulomb=number(values, "friction.coulomb"),
        static_ratio=number(values, "friction.static_ratio"),
        stribeck_velocity=number(values, "friction.stribeck_velocity"),
        velocity_scale=number(values, "friction.velocity_scale"),
        presliding=number(values, "friction.presliding"),
        flow_force=number(values, "flow_force"),
        offset=number(values, "disturbance.offset"),
        stiffness_drift=number(values, "drift.stiffness"),
        gain_drift=number(values, "drift.gain"),
    )
    u_max, gain_scale = number(values, "u_max"), number(values, "gain_scale")
    period = number(values, "sample_period")
    model = transfer_functions.chosen(values, "valve", "")
    try:
        return valve.design(model, period, u_max, gain_scale, disturbance, sensor.build(values))
    except valve.ModelError as error:
        raise ParameterError(str(error)) from error


def model(values: Values) -> TransferFunction:
    """Linear model of the valve, with its gain scaled. Raises ParameterError."""
    return transfer_functions.chosen(values, "valve", "").scaled(number(values, "gain_scale"))


def itself(params: valve.Params) -> valve.Params:
    """The linear valve that it is."""
    return params


def scaled(values: Values, gain: float, speed: float) -> Mapping[str, Value]:
    """Changed values of a valve with its gain and speed multiplied. Raises ParameterError."""
    made = transfer_functions.faster(model(values), gain, speed)
    return {
        "gain_scale": 1.0,
        "valve": "custom",
        "numerator": list(made.numerator),
        "denominator": list(made.denominator),
    }


def varied(params: valve.Params, gain: float, later: float, friction: float) -> valve.Params:
    """Valve with ``gain`` times the gain, ``later`` periods more of dead time, a share ``friction`` of it."""
    return params._replace(
        gain_scale=gain * params.gain_scale,
        lvdt=params.lvdt._replace(delay=params.lvdt.delay + later),
        disturbance=params.disturbance._replace(coulomb=params.disturbance.coulomb * friction),
    )


def quiet(params: valve.Params) -> valve.Params:
    """Valve without noise."""
    return params._replace(lvdt=params.lvdt._replace(noise=0.0))


def steady(params: valve.Params) -> valve.Params:
    """Valve without drift."""
    return params._replace(disturbance=params.disturbance._replace(gain_drift=0.0, stiffness_drift=0.0))


def resumed(former: Any, params: valve.Params, state: valve.State) -> valve.State:
    """State that goes on under ``params``; an LVDT with another dead time has stood still."""
    if params.lvdt.delay == former.lvdt.delay:
        return state
    history = valve.initial(params).history
    history[:] = state.x.x0
    return state._replace(history=history, newest=0)


PLANT = Plant(
    name="linear",
    text="proportional directional control valve with friction, flow force, amplifier and LVDT",
    module=valve,
    parameters=(),
    build=build,
    model=model,
    linear=itself,
    scaled=scaled,
    varied=varied,
    quiet=quiet,
    steady=steady,
    resumed=resumed,
    choices=(*transfer_functions.MODELS, "custom"),
    compiled=False,
)
