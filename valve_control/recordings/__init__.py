# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Analyses and replays recorded runs: the signals and parameters of valves in a bag."""
