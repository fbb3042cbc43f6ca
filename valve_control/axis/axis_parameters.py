# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of a hydraulic axis, and builds the machine from checked values.

The valve that feeds it has the parameters of ``valve_simulator``; they are those of ``table.py``.
"""

import math
import os
from pathlib import Path
from typing import Any

from valve_control.axis import axis, axis_arc_sampled, axis_pid, machine, upper
from valve_control.control.laws.common import SAMPLE_PERIOD
from valve_control.control.parameters import build, files, ros_file
from valve_control.control.parameters.command import MESSAGE
from valve_control.control.parameters.controller import AUTOSTART, CONTROLLER
from valve_control.control.parameters.valve import VALVE
from valve_control.control.plant import registry, sensor, valve
from valve_control.parameter import (
    Parameter,
    ParameterError,
    Table,
    Values,
    defaults,
    number,
    numbers,
    one_of,
    updated,
    word,
)

GRAVITY = 9.80665  # m/s²
CONSTANT_VOLUME = 1e9  # m³; a supply so large that no flow changes its pressure


def of_node(*parameters: Parameter) -> Table:
    """``parameters`` that only a node reads."""
    return tuple(p._replace(node_only=True) for p in parameters)


AXIS: Table = (
    SAMPLE_PERIOD,
    Parameter(
        "cylinder.area_a", 0.00125, "m²", "area of the piston on side a, which extends the rod", 1e-6, 10.0
    ),
    Parameter("cylinder.area_b", 0.00076, "m²", "area of the piston on side b, without the rod", 1e-6, 10.0),
    Parameter("cylinder.stroke", 0.5, "m", "travel of the piston from stop to stop", 1e-3, 50.0),
    Parameter(
        "cylinder.dead_volume_a", 1e-4, "m³", "volume of line and chamber a, piston retracted", 1e-8, 10.0
    ),
    Parameter(
        "cylinder.dead_volume_b", 1e-4, "m³", "volume of line and chamber b, piston extended", 1e-8, 10.0
    ),
    Parameter("cylinder.leakage", 1e-13, "m³/s/Pa", "laminar leakage between the chambers", 0.0, 1e-6),
    Parameter(
        "cylinder.external_leakage", 0.0, "m³/s/Pa", "laminar leakage of each chamber to the tank", 0.0, 1e-6
    ),
    Parameter("load.mass", 200.0, "kg", "moving mass, reduced to the piston", 1e-3, 1e7),
    Parameter("load.damping", 500.0, "N·s/m", "viscous friction", 0.0, 1e8),
    Parameter("load.stiffness", 0.0, "N/m", "stiffness of the spring", 0.0, 1e10),
    Parameter("load.rest", 0.0, "m", "position at which the spring has no force", -100.0, 100.0),
    Parameter("load.force", 0.0, "N", "external force, positive in the direction of extension", -1e8, 1e8),
    Parameter("load.inclination", 0.0, "deg", "angle of the extension above the horizontal", -90.0, 90.0),
    Parameter("load.coulomb", 0.0, "N", "Coulomb friction", 0.0, 1e7),
    Parameter("load.static_ratio", 1.0, "-", "static friction over Coulomb friction", 1.0, 10.0),
    Parameter("load.stribeck_velocity", 0.02, "m/s", "velocity at which the static part decays", 1e-6, 10.0),
    Parameter("load.presliding", 2e-5, "m", "travel over which Coulomb friction builds up", 1e-7, 0.01),
    Parameter("fluid.bulk_modulus", 1.4e9, "Pa", "effective bulk modulus, with lines and air", 1e7, 1e11),
    Parameter(
        "fluid.vapour_pressure", 3000.0, "Pa", "absolute vapour pressure, below which none falls", 0.0, 1e5
    ),
    Parameter("fluid.tank_pressure", 1e5, "Pa", "absolute pressure in the tank and around the rod", 1e3, 1e7),
    Parameter("spool.flow", 5e-4, "m³/s", "flow over one fully open edge at spool.flow_pressure", 1e-9, 1.0),
    Parameter("spool.flow_pressure", 35e5, "Pa", "pressure difference of spool.flow", 1e3, 1e8),
    Parameter("spool.full_scale", 10.0, "V", "position at which the edges are fully open", 0.01, 100.0),
    Parameter(
        "spool.overlap", [0.03] * 4, "-", "overlaps over full_scale: P-A, P-B, A-T, B-T", -0.5, 0.9, length=4
    ),
    Parameter("spool.gain", [1.0] * 4, "-", "flow of the same edges over spool.flow", 0.0, 10.0, length=4),
    Parameter(
        "spool.laminar_pressure", 1e5, "Pa", "pressure difference below which the flow is laminar", 1.0, 1e7
    ),
    Parameter(
        "supply.kind", "constant", "", "constant, or pump and relief valve", choices=("constant", "pump")
    ),
    Parameter(
        "supply.pressure", 140e5, "Pa", "pressure of a constant supply; initial one of a pump's", 1e5, 1e8
    ),
    Parameter("supply.volume", 1e-3, "m³", "volume between pump and spool", 1e-7, 100.0),
    Parameter("supply.flow", 1e-3, "m³/s", "flow of the pump", 0.0, 10.0),
    Parameter("supply.leakage", 1e-12, "m³/s/Pa", "leakage of the pump", 0.0, 1e-6),
    Parameter("relief.pressure", 140e5, "Pa", "pressure at which the relief valve begins to open", 1e5, 1e8),
    Parameter("relief.spring", 1e-8, "m³/s/Pa", "flow per pressure above it, by the spring", 1e-13, 1e-3),
    Parameter("relief.flow_force", 1e-8, "m³/s/Pa", "the same by its flow force", 1e-13, 1e-3),
    Parameter("relief.flow", 1e-2, "m³/s", "flow of the fully open relief valve at 70 bar", 1e-9, 10.0),
    Parameter(
        "relief.time_constant", 0.001, "s", "time constant of the poppet of the relief valve", 1e-5, 10.0
    ),
    Parameter("start.position", 0.25, "m", "initial position of the piston", 0.0, 50.0),
    Parameter("start.pressure_a", 50e5, "Pa", "initial pressure in chamber a", 0.0, 1e8),
    Parameter("start.pressure_b", 80e5, "Pa", "initial pressure in chamber b", 0.0, 1e8),
    Parameter("position.noise", 0.0, "m", "standard deviation of the position sensor", 0.0, 1.0),
    Parameter("position.resolution", 0.0, "m", "quantisation step of the position sensor; 0: none", 0.0, 1.0),
    Parameter("position.delay", 0.0, "s", "dead time of the position sensor", 0.0, 1.0),
    Parameter("pressure.noise", 0.0, "Pa", "standard deviation of the pressure sensors", 0.0, 1e8),
    Parameter(
        "pressure.resolution", 0.0, "Pa", "quantisation step of the pressure sensors; 0: none", 0.0, 1e8
    ),
    Parameter("pressure.delay", 0.0, "s", "dead time of the pressure sensors", 0.0, 1.0),
    Parameter("seed", 1, "", "seed of the noise of all sensors", 0, 2**31 - 1),
    Parameter("integration.steps", 4, "", "integration steps in a sample period", 1, 1000),
    *of_node(
        Parameter("joint", "axis", "", "name of the joint on joint_states"),
        Parameter(
            "listeners", 1, "", "node, lockstep: number of subscriptions of joint_states to wait for", 0, 100
        ),
        Parameter(
            "fault.position",
            "none",
            "",
            "injected fault of the position sensor",
            choices=("none", "silent", "frozen", "jump", "out_of_range", "not_finite"),
        ),
        Parameter(
            "fault.pressure",
            "none",
            "",
            "fault of both sensors",
            choices=("none", "silent", "jump", "not_finite"),
        ),
    ),
)
NOMINAL = 70e5  # Pa  pressure difference of relief.flow

AXIS_CONTROLLER: Table = (
    SAMPLE_PERIOD,
    Parameter(
        "upper_level", "axis_pid", "", "PID with feedforward, or adaptive robust", choices=tuple(upper.LEVELS)
    ),
    *axis_pid.PARAMETERS,
    *axis_arc_sampled.PARAMETERS,
    Parameter(
        "course",
        "point_to_point",
        "",
        "the first is limited in jerk",
        choices=("point_to_point", "sine", "step"),
    ),
    Parameter("offset", 0.0, "m", "distance of the beginning of the course from start.position", -50.0, 50.0),
    Parameter("distance", 0.1, "m", "distance of the motion; amplitude of the sine", -50.0, 50.0),
    Parameter("back", True, "", "point to point: move there and back"),
    Parameter("pause", 0.5, "s", "standstill before each motion", 0.0, 1e4),
    Parameter("duration", 3.0, "s", "duration of the run", 0.01, 1e5),
    Parameter("frequency", 1.0, "Hz", "frequency of the sine", 1e-3, 1e3),
    Parameter("max_velocity", 0.25, "m/s", "largest velocity of the course", 1e-4, 100.0),
    Parameter("max_acceleration", 2.0, "m/s²", "largest acceleration of the course", 1e-4, 1e4),
    Parameter("max_jerk", 40.0, "m/s³", "largest jerk of the course", 1e-3, 1e7),
    MESSAGE,
    *of_node(
        Parameter(
            "machine", "", "", "name in config/axis or parameter file that has stroke and velocity gains"
        ),
        Parameter("joint", "axis", "", "name of the joint on joint_states and in trajectories"),
        Parameter("lockstep", False, "", "answer each reading when all listeners are there"),
        Parameter(
            "start_tolerance", 0.002, "m", "largest distance of a trajectory's start from the goal", 0.0, 50.0
        ),
        Parameter(
            "error_limit", 0.05, "m", "position error at which the axis is stopped; 0: none", 0.0, 50.0
        ),
        Parameter(
            "sensor.timeout", 0.05, "s", "silence of a sensor at which the axis is stopped", 0.001, 100.0
        ),
        Parameter(
            "sensor.tolerance", 0.002, "m", "tolerance of a position beyond stroke or speed", 0.0, 10.0
        ),
        Parameter(
            "sensor.max_speed", 2.0, "m/s", "highest speed of a position that is not a jump", 1e-3, 1e3
        ),
        Parameter(
            "sensor.pressure_high", 4e7, "Pa", "highest pressure that a pressure sensor can show", 1e5, 1e9
        ),
        Parameter("sensor.pressure_jump", 2e7, "Pa", "change between readings that is a jump", 1e4, 1e9),
        Parameter("sensor.hold_samples", 3, "", "number of wrong readings in a row that is bridged", 0, 1000),
        Parameter(
            "stop.controller", "controller", "", "valve controller that a stop deactivates (0 V); empty: none"
        ),
        Parameter(
            "stop.delay", 0.2, "s", "time from the command of 0 V of a stop to this deactivation", 0.0, 100.0
        ),
    ),
    AUTOSTART,
)
AXIS_NODES: dict[str, Table] = {
    "axis_simulator": AXIS,
    "axis_controller": AXIS_CONTROLLER,
    "valve_simulator": VALVE,
    "controller": CONTROLLER,
}


def _refuse_impossible(values: Values) -> None:
    """Raise ParameterError for a start beyond the stroke, or for pressures below one that must be less."""

    def of(name: str) -> float:
        return number(values, name)

    if of("start.position") > of("cylinder.stroke"):
        raise ParameterError(
            f"start.position is {of('start.position'):g} m; it must lie within cylinder.stroke, "
            f"{of('cylinder.stroke'):g} m"
        )
    vapour = of("fluid.vapour_pressure")
    for name in ("fluid.tank_pressure", "start.pressure_a", "start.pressure_b"):
        if of(name) < vapour:
            raise ParameterError(f"{name} is {of(name):g} Pa, below fluid.vapour_pressure, {vapour:g} Pa")
    bulk, pump = of("fluid.bulk_modulus"), word(values, "supply.kind") == "pump"
    for name in ("supply.pressure", "start.pressure_a", "start.pressure_b", *(["relief.pressure"] * pump)):
        if of(name) >= bulk:  # no content of a room has twice that pressure
            raise ParameterError(
                f"fluid.bulk_modulus is {bulk:g} Pa; it must be above {name}, {of(name):g} Pa"
            )
    if of("supply.pressure") < of("fluid.tank_pressure"):
        raise ParameterError(
            f"supply.pressure is {of('supply.pressure'):g} Pa, below fluid.tank_pressure, "
            f"{of('fluid.tank_pressure'):g} Pa"
        )


def axis_params(values: Values) -> axis.Params:
    """Axis from the values of ``axis_simulator``. Raises ParameterError."""

    def of(name: str) -> float:
        return number(values, name)

    _refuse_impossible(values)
    constant = word(values, "supply.kind") == "constant"
    weight = of("load.mass") * GRAVITY * math.sin(math.radians(of("load.inclination")))
    nominal = of("spool.flow") / math.sqrt(of("spool.flow_pressure"))
    return axis.Params(
        cylinder=axis.Cylinder(
            dead_a=of("cylinder.dead_volume_a"),
            dead_b=of("cylinder.dead_volume_b"),
            **{p: of(f"cylinder.{p}") for p in ("area_a", "area_b", "stroke", "leakage", "external_leakage")},
        ),
        load=axis.Load(
            force=of("load.force") - weight,
            bristle_stiffness=of("load.coulomb") / of("load.presliding"),
            **{p: of(f"load.{p}") for p in ("mass", "damping", "stiffness", "rest", "coulomb")},
            **{p: of(f"load.{p}") for p in ("static_ratio", "stribeck_velocity")},
        ),
        coefficients=axis.Edges(*(nominal * gain for gain in numbers(values, "spool.gain"))),
        overlaps=axis.Edges(*numbers(values, "spool.overlap")),
        full_scale=of("spool.full_scale"),
        supply=axis.Supply(
            volume=CONSTANT_VOLUME if constant else of("supply.volume"),
            pump_flow=0.0 if constant else of("supply.flow"),
            pump_leakage=0.0 if constant else of("supply.leakage"),
            tank=of("fluid.tank_pressure"),
            relief_pressure=of("relief.pressure"),
            relief_spring=math.sqrt(NOMINAL) / of("relief.spring"),
            relief_flow_force=1.0 / (of("relief.flow_force") * math.sqrt(NOMINAL)),
            relief_limit=0.0 if constant else of("relief.flow") / math.sqrt(NOMINAL),
            relief_time=of("relief.time_constant"),
        ),
        bulk_modulus=of("fluid.bulk_modulus"),
        vapour=of("fluid.vapour_pressure"),
        laminar=of("spool.laminar_pressure"),
        period=of("sample_period"),
        steps=of("integration.steps"),
    )


def steady_speed(p: axis.Params, supply: float, outwards: bool) -> float:
    """Speed [m/s] with fully open edges at a ``supply`` pressure [Pa]; 0 if the load stalls the axis.

    Over each edge the pressure falls by (A·v/k)²; what is left carries the constant forces and Coulomb
    friction (docs/explanation/axis.md). Viscous friction, spring, leakage and laminar flow are left out.
    """
    c, k, load = p.cylinder, p.coefficients, p.load
    resting = load.force - p.supply.tank * (c.area_a - c.area_b)  # outwards
    if outwards:
        left = supply * c.area_a - p.supply.tank * c.area_b + resting - load.coulomb
        loss = c.area_a**3 / k.pa**2 + c.area_b**3 / k.bt**2 if k.pa * k.bt > 0.0 else math.inf
    else:
        left = supply * c.area_b - p.supply.tank * c.area_a - resting - load.coulomb
        loss = c.area_b**3 / k.pb**2 + c.area_a**3 / k.at**2 if k.pb * k.at > 0.0 else math.inf
    return math.sqrt(max(0.0, left) / loss)


def supply_pressure(values: Values) -> float:
    """Pressure [Pa] at which the supply feeds the axis: of a pump that of its relief valve."""
    constant = word(values, "supply.kind") == "constant"
    return number(values, "supply.pressure" if constant else "relief.pressure")


def velocity_gains(p: axis.Params, values: Values) -> tuple[float, float]:
    """Velocity per spool position beyond the overlap [m/s/V], outwards and inwards. Raises ParameterError."""
    supply = supply_pressure(values)
    found = []
    for outwards, overlap in ((True, p.overlaps.pa), (False, p.overlaps.pb)):
        speed = steady_speed(p, supply, outwards)
        if speed == 0.0:
            raise ParameterError(
                f"the axis cannot move {'outwards' if outwards else 'inwards'}: at {supply:g} Pa the load "
                "stalls it, or an edge of spool.gain is closed"
            )
        found.append(speed / (p.full_scale * (1.0 - max(0.0, overlap))))
    return found[0], found[1]


def upper_level(values: Values, plant: axis.Params, machine_values: Values) -> Any:
    """Params of the upper level that ``values`` of ``axis_controller`` choose. Raises ParameterError.

    ``plant`` is what is known of the axis, with the values of ``axis_simulator`` that it was made from.
    """
    gains = velocity_gains(plant, machine_values)
    if word(values, "upper_level") == axis_arc_sampled.NAME:
        return axis_arc_sampled.build(values, plant, supply_pressure(machine_values))
    return axis_pid.build(values, *gains)


def known_machine(name: str) -> Values:
    """Values of ``axis_simulator`` of the machine ``name``: a file in config/axis, or a path.

    Raises ParameterError.
    """
    folder = ros_file.config_folder() / "axis"
    path = folder / f"{name}.yaml"
    if not path.is_file():
        path = Path(os.path.expanduser(name))
    if not path.is_file():
        known = one_of(sorted(p.stem for p in folder.glob("*.yaml")))
        raise ParameterError(f"machine is '{name}'; it must be {known}, or the path of a parameter file")
    values = updated(AXIS, defaults(AXIS), files.load(str(path), [], AXIS_NODES)["axis_simulator"])
    axis_params(values)
    return values


def sensors(values: Values) -> machine.Sensors:
    """Sensors from the values of ``axis_simulator``."""
    return machine.Sensors(sensor.build(values, "position"), sensor.build(values, "pressure"))


def machine_params(axis_values: Values, valve_values: Values) -> machine.Params:
    """Machine from the values of ``axis_simulator`` and ``valve_simulator``. Raises ParameterError."""
    period = number(axis_values, "sample_period")
    if number(valve_values, "sample_period") != period:
        raise ParameterError(
            f"sample_period is {period:g} s for the axis and "
            f"{number(valve_values, 'sample_period'):g} s for its valve; they must be equal"
        )
    fed = build.valve_params(valve_values)
    if not isinstance(fed, valve.Params):
        raise ParameterError(
            f"valve is '{word(valve_values, 'valve')}'; the valve of an axis must be "
            f"{one_of(registry.PLANTS['linear'].values)}"
        )
    return machine.Params(fed, axis_params(axis_values), sensors(axis_values))


def start(p: machine.Params, values: Values) -> machine.State:
    """Machine at rest at start.position with the start's pressures."""
    names = ("start.position", "start.pressure_a", "start.pressure_b", "supply.pressure")
    return machine.begin(p, axis.initial(p.axis, *(number(values, name) for name in names)))
