# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Commands, supervises and simulates hydraulic axes above a valve: upper levels, paths, cylinder and load."""
