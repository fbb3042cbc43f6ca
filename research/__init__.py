# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Research behind the product, run from a checkout: theorems, paper, axes, tuned laws, campaigns."""

import sys

from valve_control.control.compiling import add_sources

add_sources(sys.modules[__name__])
