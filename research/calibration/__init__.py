# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Searches for a simulated valve on which PID, ARC and OARC give Table 1 of the paper."""
