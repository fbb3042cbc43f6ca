# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Drivers of amplifier and LVDT: signals in the device's own unit, in and out; no ROS."""
