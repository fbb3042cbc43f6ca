# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes ``python -m valve_control.cli`` the same as the `valve-control` command."""

import sys

from valve_control.cli import main

sys.exit(main())
