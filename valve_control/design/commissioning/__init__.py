# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Commissions a running valve: tests within limits, model, gains, verification; knows no ROS."""
