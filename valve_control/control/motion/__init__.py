# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Moves an axis: courses to follow, and the upper levels that command the spool, as pure steps on numbers."""
