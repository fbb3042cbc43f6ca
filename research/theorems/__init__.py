# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tests both theorems on thousands of random valves, and the sample period that the printed law needs."""
