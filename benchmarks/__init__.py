# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: ratios of times measured in one run."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the command: matrices are small
