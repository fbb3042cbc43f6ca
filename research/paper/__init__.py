# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes the paper's Table 1 and figures again, with our valve and our controllers."""

from valve_control.control.analysis.indices import Indices

PAPER_TABLE_1 = {
    "pid": Indices(0.207, 0.147, 0.038, 2.313, 0.423),
    "arc": Indices(0.145, 0.112, 0.032, 2.362, 0.416),
    "oarc": Indices(0.158, 0.120, 0.036, 2.314, 0.341),
}
