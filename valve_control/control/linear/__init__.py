# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Linear form of the loop of a law and a valve: poles, stability, margins, and swings on friction."""
