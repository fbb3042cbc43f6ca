# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes the paper's Table 1 and figures again, with our valve and our controllers."""
