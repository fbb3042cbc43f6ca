# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates the valve: models (2) and (3), friction, flow force, drift, amplifier and LVDT."""
