# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What a command said on standard error."""


def sentences(err):
    """Lines without those of progress, which a busy machine makes come."""
    return [line for line in err.strip().splitlines() if not line.endswith(" s left")]
