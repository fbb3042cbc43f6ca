# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters that all laws share: sample period and limit of the voltage."""

from valve_control.parameter import Parameter, Table

SAMPLE_PERIOD = Parameter("sample_period", 0.001, "s", "sample period ΔT of LVDT and controller", 1e-5, 0.1)
U_MAX = Parameter("u_max", 10.0, "V", "limit of the solenoid voltage", 0.1, 100.0)
COMMON: Table = (SAMPLE_PERIOD, U_MAX)
