# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads, writes and repairs rosbag2 bags (ROS 2 recordings) without needing ROS."""
