# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Research behind the product, run from a checkout: theorems, paper, axes, tuned laws, campaigns."""

from pathlib import Path

from valve_control.control.compiling import add_sources

add_sources(__name__, Path(__file__).parent, laws=False)
