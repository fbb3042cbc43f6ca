# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates closed loops: one run, batches of many valves, and studies of robustness."""
