# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps a law safe on a machine: rejects bad readings, bridges gaps, switches off, swaps laws. No ROS."""
