# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of `valve_simulator`."""

from valve_control.control.laws.common import SAMPLE_PERIOD, U_MAX
from valve_control.control.parameters.controller import AUTOSTART, REALTIME
from valve_control.control.plant import common, registry, sensor, transfer_functions
from valve_control.parameter import Parameter, Table

FAULT_SAMPLES = Parameter(
    "fault.samples", 0, "", "samples that a fault lasts; 0: until it is none", 0, 10**9, node_only=True
)

VALVE: Table = (
    SAMPLE_PERIOD,
    U_MAX,
    Parameter(
        "valve",
        "fourth_order",
        "",
        "model of the valve: second_order (2), fourth_order (3) or custom: linear; solenoid: coil, "
        "hysteresis, two sides, spool with friction and stops",
        choices=tuple(registry.CHOICES),
        left_out=tuple(registry.LEFT_OUT.items()),
    ),
    *transfer_functions.custom_parameters(""),
    common.GAIN_SCALE,
    Parameter("seed", 1, "", "seed of the LVDT noise", 0, 2**31 - 1),
    Parameter(
        "patience",
        0.01,
        "s",
        "longest wait for a late voltage; then the last holds",
        0.0,
        1.0,
        node_only=True,
    ),
    *common.DISTURBANCES,
    Parameter(
        "listeners", 1, "", "lockstep: subscriptions awaited before the first reading", 1, 100, node_only=True
    ),
    *sensor.PARAMETERS,
    Parameter(
        "clock",
        "wall",
        "",
        "a sample per period of real time, or the next as soon as the voltage has come",
        choices=("wall", "lockstep"),
        node_only=True,
    ),
    Parameter(
        "voltage_timeout",
        0.1,
        "s",
        "silence of the voltage that counts as 0 V; 0.0: none",
        0.0,
        1e6,
        node_only=True,
    ),
    Parameter(
        "fault.lvdt",
        "none",
        "",
        "injected fault of the LVDT; lost: the reading is sent as a frame that DDS cannot read; flipped: "
        "wrong sign; half: half of the gain",
        choices=(
            "none",
            "lost",
            "silent",
            "frozen",
            "out_of_range",
            "not_finite",
            "jump",
            "flipped",
            "half",
        ),
        node_only=True,
    ),
    Parameter("fault.jump", 3.0, "V", "size of the fault jump", -100.0, 100.0, node_only=True),
    Parameter(
        "fault.valve",
        "none",
        "",
        "injected fault: a stuck spool, or a fifth of the gain",
        choices=("none", "stuck", "weak"),
        node_only=True,
    ),
    FAULT_SAMPLES,
    AUTOSTART,
    *REALTIME,
    *(parameter for plant in registry.PLANTS.values() for parameter in plant.parameters),
)
