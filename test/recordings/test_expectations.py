# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import pytest

from valve_control.recordings.expectations import check

VALVES = {
    name: {
        "indices": {"e_M": 0.1, "e_F": 0.0, "e_rms": e_rms, "u_rms": 1.0, "c_u": None},
        "timing": {"spool_position": {"lost": 0, "gaps": 3, "jitter_s": {"p99": 1e-4}}},
        "latency_s": {"p50": 2e-4, "p99": 5e-4, "max": 1e-3},
        "unanswered": 0,
        "lyapunov_over_bound": None,
        "sample_period_s": 0.001,
    }
    for name, e_rms in (("boom", 0.01), ("arm", 0.03))
}


@pytest.mark.parametrize(
    ("text", "met"),
    [
        ("e_rms<0.02", [True, False]),
        ("boom.e_rms < 0.02", [True]),
        ("arm.e_rms>=0.03", [True]),
        ("timing.spool_position.gaps==3", [True, True]),
        ("boom.timing.spool_position.jitter_s.p99 <= 1e-4", [True]),
        ("latency_s.p99!=5e-4", [False, False]),
        ("boom.c_u<1.0", [False]),
        ("boom.lyapunov_over_bound<=1", [False]),
    ],
)
def test_conditions(text, met):
    assert [outcome.met for outcome in check(text, VALVES)] == met
