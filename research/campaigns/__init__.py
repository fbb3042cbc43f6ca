"""Campaigns against running nodes: injected faults, joining processes, the paper's runs in lockstep."""

from valve_control.nodes import leave_quietly, program

TOOLS = ("faults", "joiners", "paper")

if program() in TOOLS:
    leave_quietly(130)
