# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np

from valve_control.control.laws import velocity


def test_gain_at_the_cutoff_is_minus_three_decibel():
    period, cutoff = 1e-5, 50.0
    p = velocity.design(cutoff, period)
    s = velocity.State(0.0, 0.0)
    t = np.arange(40000) * period
    w = 2.0 * math.pi * cutoff
    out = []
    for x in np.sin(w * t):
        s = velocity.step(p, s, float(x))
        out.append(s.velocity)
    assert math.isclose(max(out[20000:]) / w, math.sqrt(0.5), rel_tol=0.01)
