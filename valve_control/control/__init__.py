# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Controls a valve without ROS: laws, supervision, plants, drivers, parameters, offline simulation."""
