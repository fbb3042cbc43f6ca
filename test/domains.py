# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""ROS domains: no two workers of a run have the same, whatever their process ids are."""

import os

RUN = os.getppid() if "PYTEST_XDIST_WORKER" in os.environ else os.getpid()
WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
OWN = 1 + 2 * ((RUN + 23 * WORKER) % 48)  # of a worker's tests, whose processes inherit it: 1 to 95
BESIDE = OWN + 1  # of the tools that its tests run
