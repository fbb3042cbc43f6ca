# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tools that start the nodes as processes, disturb and measure them; no node imports anything from here."""
