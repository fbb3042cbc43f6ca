# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs of real nodes: the demo, injected faults, joining processes, the paper's runs in lockstep."""

from valve_control.nodes import leave_quietly, program

TOOLS = ("demo", "faults", "joiners", "lockstep", "paper")

if program() in TOOLS:
    leave_quietly(130)
