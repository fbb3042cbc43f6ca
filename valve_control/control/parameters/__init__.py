# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists every parameter with type, default, range and unit, and builds laws and valve from values. No ROS."""
