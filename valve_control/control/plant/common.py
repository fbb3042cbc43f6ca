# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters that all plants share: gain, friction, other disturbances and LVDT."""

from valve_control.control.plant import sensor
from valve_control.parameter import Parameter, Table

GAIN_SCALE = Parameter("gain_scale", 1.0, "-", "multiplies the gain of the model", 0.01, 100.0)
DISTURBANCES: Table = (
    Parameter("friction.coulomb", 0.0, "V", "Coulomb friction as input voltage", 0.0, 100.0),
    Parameter("friction.static_ratio", 1.0, "-", "static friction over Coulomb friction", 1.0, 10.0),
    Parameter(
        "friction.stribeck_velocity", 0.1, "V/s", "velocity at which the static part decays", 1e-6, 1e3
    ),
    Parameter(
        "friction.velocity_scale",
        0.02,
        "V/s",
        "half width of the linear zone of friction without presliding",
        1e-6,
        1e3,
    ),
    Parameter(
        "friction.presliding",
        0.0,
        "V",
        "motion over which friction builds up like a spring (Dahl, LuGre); 0: none",
        0.0,
        10.0,
    ),
    Parameter("flow_force", 0.0, "V/V", "flow force as input voltage against the position", -10.0, 10.0),
    Parameter("disturbance.offset", 0.0, "V", "constant input disturbance d_n", -10.0, 10.0),
    Parameter("drift.gain", 0.0, "1/s", "relative growth of the gain per second", -0.01, 10.0),
    Parameter("drift.stiffness", 0.0, "V/V/s", "growth of the flow force per second", -10.0, 10.0),
)
PARAMETERS: Table = (GAIN_SCALE, *DISTURBANCES, *sensor.PARAMETERS)
