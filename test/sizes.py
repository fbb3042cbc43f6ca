# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""How much the campaign tries: few of each in CI, all with ``CAMPAIGN=full make campaign``."""

import os

from valve_control.control.laws import registry

FULL = os.environ.get("CAMPAIGN") == "full"

LAWS = tuple(registry.LAWS) if FULL else ("arc", "compensator")  # under faults; they meet each

VALVES = 10_000 if FULL else 2_000  # of the study's box, for each law and scenario
PARAMETER_SETS = 100_000 if FULL else 20_000
INTERRUPTED_RUNS = 100 if FULL else 40
INTERRUPTED_COMMANDS = 20 if FULL else 8  # of each kind
INTERRUPTED_IMPORTS = 20 if FULL else 4  # of each program
LOCKSTEP = 20 if FULL else 3  # s of valve time, for each law
KILLED_RECORDERS = 20 if FULL else 10
