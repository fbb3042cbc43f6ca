"""Hopsan's validation models "Position Servo" and "Hydraulic43ValveTest", rebuilt from their parameters.

Hopsan's reference curves are not part of this repository. Whoever has them (the .hvd files of Models/Example
Models Validations and Models/Component Test Validations of github.com/Hopsan/hopsan, in one folder) names
the folder in HOPSAN_REFERENCES.
"""

import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from valve_control.axis import hopsan
from valve_control.parameter import ParameterError, defaults
from valve_control.parameters.axis import AXIS, axis_params
from valve_control.plant import axis

sys.path.insert(0, str(Path(__file__).parent))
from transmission_lines import position_servo  # noqa: E402

FOLDER = Path(os.environ.get("HOPSAN_REFERENCES", "."))
needs_references = pytest.mark.skipif(
    "HOPSAN_REFERENCES" not in os.environ, reason="needs Hopsan's reference curves, HOPSAN_REFERENCES"
)


def test_two_methods_give_the_same_servo():
    """Our step against transmission lines, both with 10 µs and without the delay of Hopsan's order.

    Overshoot, cavitation and limit cycle within 1 % of each column's range over the first second; at the next
    step of the goal the limit cycle's phase decides over what follows.
    """
    lines = position_servo(1e-5, 100_000)
    times, mine = hopsan.position_servo(("position.delay=0.0", "duration=1.0", "pause=10.0"))
    mine["step"] = lines[:1, 2].repeat(len(times))
    lines[0, 2] += 1e-9  # a range for the constant goal
    found = hopsan.deviations(times, mine, lines)
    assert np.max(found["position"]) < 0.01 and np.max(found["valve"]) < 0.01
    # The relief valve's first opening is a spike of less than a millisecond.
    assert np.mean(found["relief"] > 0.01) < 0.01


@needs_references
def test_the_position_servo_meets_its_reference():
    wanted = hopsan.reference(FOLDER)
    times, mine = hopsan.position_servo()
    found = hopsan.deviations(times, mine, wanted)
    assert np.max(found["position"]) < 0.01 and np.max(found["valve"]) < 0.01
    assert np.mean(found["relief"] > 0.01) < 0.03  # in spikes of less than a millisecond it is not
    assert np.all((found["step"] == 0.0) | (np.abs(wanted[:, 0] - 1.0) < 2e-3))


@needs_references
def test_the_four_edges_meet_their_reference():
    """Underlapped spool (0.1 mm of 10 mm), ramp from -1 to 1 mm in 1 s behind a lag of 1000 rad/s twice."""
    wanted = hopsan.reference(FOLDER, "Hydraulic43ValveTest.hvd")
    values = {**defaults(AXIS), "spool.overlap": [-0.01] * 4, "spool.flow_pressure": 70e5}
    values["spool.laminar_pressure"] = 1000.0
    values["spool.flow"] = 0.67 * math.pi * 0.01 * 0.0101 * math.sqrt(2.0 * 70e5 / 890.0)
    p = axis_params(values)
    at = axis.initial(p, 0.25, 100e5, 100e5, 200e5)
    t, w = wanted[:, 0], 1000.0
    ramp = -0.001 + 0.002 * (t - 2.0 / w + np.exp(-w * t) * (2.0 / w + t))
    q = [axis.flows(p, at, axis.Pressures(100e5, 100e5, 200e5), x / 0.01) for x in ramp]
    columns = np.array([(f.pa - f.at, f.pb - f.bt, -f.pa - f.pb, f.at + f.bt) for f in q])
    error = np.abs(columns - wanted[:, 1:]) / np.ptp(wanted[:, 1:], axis=0)
    assert np.max(error) < 0.01


def test_a_reference_that_is_none_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="cannot be read"):
        hopsan.compare(tmp_path)
    (tmp_path / hopsan.FILE).write_text("1, 2\n3, 4\n")
    with pytest.raises(ParameterError, match="has not the columns"):
        hopsan.compare(tmp_path)
