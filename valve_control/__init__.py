# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Controls a proportional directional control valve locally, after Bu and Yao."""

__version__ = "1.0.0"
