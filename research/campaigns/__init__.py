# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Campaigns against running nodes: injected faults, joining processes, the paper's runs in lockstep."""

from valve_control.nodes import leave_quietly, program

TOOLS = ("faults", "joiners", "lockstep", "paper")

if program() in TOOLS:
    leave_quietly(130)
