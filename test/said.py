# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What a command said on standard error."""

import re


def sentences(err):
    """Lines without those of progress, which a busy machine makes come."""
    return [line for line in err.splitlines() if line.strip() and not re.search(r"\[\d\d:\d\d", line)]
