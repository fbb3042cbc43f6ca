# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Shows valves in the browser, and lets one tune, record and undo; knows no ROS."""
