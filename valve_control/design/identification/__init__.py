# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Identifies a valve: measures its frequency response, fits a model, designs a compensator for it."""
