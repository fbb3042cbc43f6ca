# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Hydraulic axes under five valves: random axes, a published case of Delta, Hopsan's Position Servo."""
