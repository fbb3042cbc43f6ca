# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds the gains of any law for a box of valves: margins of the sampled loop, search, verification."""
