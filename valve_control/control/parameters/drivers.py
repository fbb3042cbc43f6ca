# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of a driver and of the node `valve_driver`, and makes devices from their values."""

from typing import NamedTuple

from valve_control.control.drivers.device import Device, Side
from valve_control.control.drivers.driver import Driver, Kind
from valve_control.control.drivers.registry import KINDS, LEFT_OUT
from valve_control.control.drivers.scaling import Scale, ScaleError, parse
from valve_control.control.drivers.simulated import SimulatedValve
from valve_control.control.laws.common import SAMPLE_PERIOD
from valve_control.control.parameters.controller import AUTOSTART, REALTIME
from valve_control.control.parameters.valve import VALVE
from valve_control.control.plant import registry
from valve_control.parameter import Parameter, ParameterError, Table, Values, defaults, number, word

SCALE = (
    "V, -10..10V, %, 0..10V or 4..20mA, or *factor±offset in volts, such as *1.25-15; empty: as its driver "
    "has it"
)
SIMULATED: Table = tuple(
    parameter._replace(name=f"simulated.{parameter.name}")
    for parameter in VALVE
    if not parameter.node_only and parameter.name != "sample_period"
) + (
    Parameter(
        "simulated.paced", True, "", "one sample per period of real time; false: as soon as it is requested"
    ),
)


def _simulated(values: Values, period: float, off: float) -> Driver:
    own = {p.name.removeprefix("simulated."): values[p.name] for p in SIMULATED}
    plant = {**defaults(VALVE), **own, "sample_period": period}
    del plant["paced"]
    return SimulatedValve(
        registry.chosen(plant).build(plant), int(number(plant, "seed")), own["paced"] is True
    )


DRIVERS: dict[str, Kind] = {
    **KINDS,
    "simulated": Kind("simulated", "the valve of valve_simulator, in the process", SIMULATED, _simulated),
}
DRIVER = Parameter(
    "driver",
    "serial",
    "",
    "kind of the device with amplifier and LVDT",
    choices=tuple(DRIVERS),
    left_out=tuple(LEFT_OUT.items()),
)
KINDS_PARAMETERS: Table = tuple(p for kind in DRIVERS.values() for p in kind.parameters)
SIDES: Table = (
    Parameter("position.scale", "", "", f"signal of the LVDT: {SCALE}"),
    Parameter("position.reversed", False, "", "reverse the polarity of the LVDT"),
    Parameter("position.low", -11.0, "V", "readings below count as missing", -1000.0, 1000.0),
    Parameter("position.high", 11.0, "V", "readings above count as missing", -1000.0, 1000.0),
    Parameter("voltage.scale", "", "", f"signal of the amplifier: {SCALE}"),
    Parameter("voltage.reversed", False, "", "reverse the polarity of the amplifier"),
    Parameter("voltage.low", -10.0, "V", "lower limit of the voltage", -1000.0, 0.0),
    Parameter("voltage.high", 10.0, "V", "upper limit of the voltage", 0.0, 1000.0),
)
VALVE_DRIVER: Table = (
    DRIVER,
    SAMPLE_PERIOD,
    *SIDES,
    Parameter("watchdog", 0.1, "s", "silence of valve_voltage after which the output is 0 V", 0.005, 60.0),
    Parameter(
        "answer_share", 0.8, "-", "share of the period for which a reading's voltage is awaited", 0.0, 0.95
    ),
    AUTOSTART,
    *REALTIME,
    *KINDS_PARAMETERS,
)
DEVICE: Table = (DRIVER, *SIDES, *KINDS_PARAMETERS)  # of a controller that has the device itself
LIVE = frozenset(
    {"watchdog", "answer_share", "position.low", "position.high", "voltage.low", "voltage.high"}
    | {parameter.name for parameter in REALTIME}
)  # what a running driver takes


class Sides(NamedTuple):
    """Scale and limits of reading and output."""

    position: Side
    voltage: Side


def sides(values: Values) -> Sides:
    """Scales and limits from the parameters' values. Raises ParameterError."""
    kind = DRIVERS[word(values, "driver")]
    made = []
    for name in Sides._fields:
        low, high = number(values, f"{name}.low"), number(values, f"{name}.high")
        if low >= high:
            raise ParameterError(f"{name}.low is {low:g} V; it must be below {name}.high, {high:g} V")
        made.append(Side(_scale(values, name, kind.volts), low, high))
    return Sides(*made)


def _scale(values: Values, name: str, usual: str) -> Scale:
    try:
        scale = parse(word(values, f"{name}.scale") or usual)
    except ScaleError as error:
        raise ParameterError(f"{name}.scale: {error}") from error
    return scale.reversed() if values[f"{name}.reversed"] else scale


def device(values: Values) -> Device:
    """Device, still closed, from the parameters' values. Raises ParameterError."""
    position, voltage = sides(values)
    period = number(values, "sample_period")
    driver = DRIVERS[word(values, "driver")].make(values, period, voltage.scale.signal(0.0))
    return Device(driver, position, voltage, period)
