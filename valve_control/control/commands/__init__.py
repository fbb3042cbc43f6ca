# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes the commands of an upper level: shapes over time, or numbers from a file."""
