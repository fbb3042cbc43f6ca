# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Formats the table of indices that all commands print."""

from collections.abc import Sequence

HEADER = f"{'':14}{'e_M [V]':>10}{'e_F [V]':>10}{'e_rms [V]':>11}{'u_rms [V]':>11}{'c_u':>9}"


def index_row(label: str, values: Sequence[float]) -> str:
    """One line of the table of indices."""
    e_m, e_f, e_rms, u_rms, c_u = values
    return f"{label:14}{e_m:10.4f}{e_f:10.4f}{e_rms:11.4f}{u_rms:11.3f}{c_u:9.4f}"
