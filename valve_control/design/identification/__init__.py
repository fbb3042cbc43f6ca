# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Identifies a valve: measures its frequency response, fits models to it (Bode fit), gives first gains."""
