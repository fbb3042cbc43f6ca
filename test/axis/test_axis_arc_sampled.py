# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The sampled adaptive robust upper level: its observer, its lead, and what it makes of an axis."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.axis import axis_arc_sampled as level
from valve_control.axis import axis_parameters as parameters
from valve_control.axis import run
from valve_control.axis.axis_arc import Theta
from valve_control.axis.axis_parameters import AXIS, AXIS_CONTROLLER, AXIS_NODES
from valve_control.axis.course import Goal
from valve_control.axis.machine import Reading
from valve_control.parameter import defaults, updated

SWIFT = 2.0 * math.pi * 300.0  # rad/s  of a valve that hardly matters


def built(machine=None, **own):
    """Params for a machine with its defaults and ``machine``'s changes; ``own``: names without axis_arc."""
    at = updated(AXIS, defaults(AXIS), machine or {})
    given = {f"axis_arc.{name}" if f"axis_arc.{name}" in NAMES else name: v for name, v in own.items()}
    values = updated(AXIS_CONTROLLER, defaults(AXIS_CONTROLLER), {"upper_level": "axis_arc", **given})
    return parameters.upper_level(values, parameters.axis_params(at), at)


NAMES = {p.name for p in AXIS_CONTROLLER}


def test_the_observer_has_three_equal_poles():
    """A second derivation of its gains: the matrix of its errors, found by moving each of its states."""
    p = built({"load.damping": 0.0}, observer=150.0)
    none = Theta(1.0, 0.0, 0.0, 0.0, 1e9)

    def after(position, velocity, unexplained):
        s = level.initial(p)._replace(
            theta=none, samples=1.0, position=position, velocity=velocity, unexplained=unexplained
        )
        s = level.observed(p, s, Reading(0.0, 0.0, 0.0, 0.0))
        return s.position, s.velocity, s.unexplained

    # In units in which the three are of one size.
    scale = np.array([1.0, 1.0 / p.law.period, 1.0 / p.law.period**2])
    matrix = np.array([after(*row) for row in np.diag(scale)]).T / scale[:, None]
    z = math.exp(-150.0 * p.law.period)
    assert np.poly(matrix) == pytest.approx(np.poly([z, z, z]), abs=1e-9)


def test_the_observer_finds_velocity_and_what_the_estimates_do_not_explain():
    p = built({"load.damping": 0.0}, mass=150.0)
    theta = p.begin
    s = level.observed(p, level.initial(p), Reading(0.0, 0.1, 50e5, 80e5))
    assert (s.position, s.velocity, s.unexplained) == (0.1, 0.0, 0.0)
    force = level.load_force(p.law.model, 50e5, 80e5)
    for k in range(1, 400):
        t = k * p.law.period
        s = level.observed(p, s, Reading(0.0, 0.1 + 0.15 * t * t, 50e5, 80e5))
    explained = level.explained(p.law, theta, s.velocity, force)
    assert s.velocity == pytest.approx(0.3 * 399 * p.law.period, abs=2e-3)
    assert explained + s.unexplained == pytest.approx(0.3, abs=0.02)


finite = st.floats(-1e3, 1e3)


@given(
    st.lists(
        st.tuples(finite, finite, finite, finite, st.floats(-1e9, 1e9), st.floats(-1e9, 1e9)), max_size=8
    )
)
def test_whatever_the_sensors_say_command_and_estimates_keep_their_limits(rows):
    p = built(spool_limit=7.0, learning=0.01)
    s = level.initial(p)
    for position, velocity, acceleration, reading, a, b in rows:
        goal = Goal(position, velocity, acceleration)
        command, s, terms = level.step(p, s, goal, Reading(0.0, reading, a, b))
        assert abs(command) <= 7.0 and terms.spool == command and terms.error == position - reading
        for value, low, high in zip(s.theta, p.law.low, p.law.high, strict=True):
            assert low <= value <= high
        told = level.estimates(s)
        assert all(math.isfinite(number) for number in told.values()) and told["mass_kg"] > 0.0


def cascade(machine, **own):
    """A run without friction and noise under a swift valve; ``own`` is of the upper level."""
    settings = run.default_settings()
    frictionless = {
        "spool.overlap": [0.0] * 4,
        "cylinder.leakage": 0.0,
        "cylinder.area_b": 0.00076,
        "start.pressure_a": 30e5,
        "start.pressure_b": (30e5 * 0.00125 - 1e5 * 0.00049) / 0.00076,
        **machine,
    }
    valve = {"valve": "custom", "numerator": [SWIFT**2], "denominator": [1.0, 1.4 * SWIFT, SWIFT**2]}
    changes = {
        "axis_simulator": frictionless,
        "axis_controller": {"upper_level": "axis_arc", "overlap": 0.0, **own},
        "valve_simulator": valve,
        "controller": {"controller": "open_loop", "open_loop.static_gain": 1.0},
    }
    for node, new in changes.items():
        settings[node] = updated(AXIS_NODES[node], settings[node], {**new, "sample_period": 0.00025})
    return run.setup(settings)


SINE = {"course": "sine", "distance": 0.05, "frequency": 0.8, "duration": 8.0}
GAINS = {
    "axis_arc.k1": 25.0,
    "axis_arc.k2": 60.0,
    "axis_arc.k3": 80.0,
    "axis_arc.coupling": 60.0,
    "axis_arc.lead": 0.0009,
}
SHARP = {"axis_arc.observer": 1000.0, "axis_arc.pressure_cutoff": 1500.0}


@cache
def late_error(mass, learning, duration=8.0):
    """Largest error [m] in the last second of a sine, with an estimate of the mass that is off."""
    own = {**SINE, **GAINS, **SHARP, "axis_arc.mass": mass, "axis_arc.learning": learning}
    return run.simulate(cascade({}, **{**own, "duration": duration})).indices.e_end


@pytest.mark.parametrize(("mass", "share"), [(140.0, 0.1), (280.0, 0.1)])
def test_with_a_wrong_mass_and_nothing_else_the_error_goes_to_that_of_sampling_by_adaptation(mass, share):
    exact, without, with_it = late_error(200.0, 1e6), late_error(mass, 1e6), late_error(mass, 0.1)
    assert without > 10.0 * exact
    assert with_it < share * without and with_it < 2.0 * exact


def test_with_a_wrong_force_the_axis_comes_to_its_goal_by_adaptation():
    """The steady state: 600 N of which the law knows nothing are learnt, whatever else the estimates do."""
    held = {"course": "step", "distance": 0.0, "duration": 4.0, **GAINS, **SHARP}
    found = []
    for learning in (1e6, 0.1):
        made = cascade({"load.force": 600.0}, **{**held, "axis_arc.learning": learning})
        p = made.cascade.upper
        wrong = p._replace(begin=p.begin._replace(force=p.begin.force - 600.0 / 200.0))
        found.append(run.simulate(made._replace(cascade=made.cascade._replace(upper=wrong))).indices.e_end)
    assert found[0] > 1e-3 and found[1] < 0.02 * found[0]


def test_the_lead_makes_up_for_the_valves_lag():
    """A valve of 100 Hz, exact parameters; the lead is its lag and half a sample."""
    lag = 1.4 / (2.0 * math.pi * 100.0)
    errors = []
    for lead in (0.0, lag + 0.000125):
        made = cascade({}, **{**SINE, **GAINS, **SHARP, "duration": 3.0, "axis_arc.lead": lead})
        slow = 2.0 * math.pi * 100.0
        values = updated(
            AXIS_NODES["valve_simulator"],
            defaults(AXIS_NODES["valve_simulator"]),
            {
                "valve": "custom",
                "numerator": [slow**2],
                "denominator": [1.0, 1.4 * slow, slow**2],
                "sample_period": 0.00025,
            },
        )
        valve = parameters.build.valve_params(values)
        errors.append(run.simulate(made._replace(machine=made.machine._replace(valve=valve))).indices.e_rms)
    assert errors[1] < 0.2 * errors[0]
