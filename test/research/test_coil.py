# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""dcarc on solenoid valves: what the magnet in the law is good for."""

from research import coil


def test_the_magnet_in_the_law_halves_the_error_of_a_sine():
    """Valve A, 10 Hz: coil, hysteresis and unequal gains together, against the coil in the model alone."""
    plain, whole = (coil.measured(coil.VALVES["A"], terms, ["sine 10 Hz"]) for terms in ((), coil.TERMS))
    assert whole.error < 0.5 * plain.error and whole.chatter < 1.1 * plain.chatter
    assert whole.error < 0.005
