# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Searches for a simulated valve on which the controllers give a measured table of indices."""
