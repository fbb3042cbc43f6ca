# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates whole axes: upper level, valve controller, valve, cylinder and load; one run, or many."""
