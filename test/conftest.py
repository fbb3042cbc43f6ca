import os
import sys
from pathlib import Path

import pytest

# One domain for each run, this host only; nodes and their processes inherit both.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
# Matrices are small: BLAS threads that wait for each other take longer.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from valve_control.parameters.table import CONTROLLER, VALVE, defaults, updated
from valve_control.simulation import offline

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def config():
    return ROOT / "config"


@pytest.fixture
def simulate():
    """Offline run from a few changes of the defaults."""

    def run(controller, command, period=0.001, compiled=True, valve=None, **changes):
        own = {"controller": controller, "sample_period": period}
        own.update({name.replace("__", "."): value for name, value in changes.items()})
        c = updated(CONTROLLER, defaults(CONTROLLER), own)
        v = updated(VALVE, defaults(VALVE), {"sample_period": period, **(valve or {})})
        return offline.simulate(c, v, command, compiled)

    return run
