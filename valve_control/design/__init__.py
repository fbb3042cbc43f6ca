# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds the model of a valve and the gains of a law: identification, tuning, commissioning."""
