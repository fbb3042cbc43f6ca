# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Evaluates runs, simulated or recorded: indices, timing, spectra, limit cycles, figures."""
