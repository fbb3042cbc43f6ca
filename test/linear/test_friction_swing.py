# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Swings that friction sustains: the describing function against the bristles, predictions against runs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from research import comparison
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import friction_swing, linear_loop, margins
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.valve import FREE
from valve_control.control.simulation import batch
from valve_control.parameter import defaults, updated

PERIOD = 0.001
RUBBING = FREE._replace(coulomb=1.0, presliding=1.0)
GAINS = "config/tuned/wide_0.25_pid_reference.yaml"


def first_harmonic(deflection, samples):
    """Of the bristles that ``valve.friction`` moves, over x = deflection·sin; ``samples`` in a cycle."""
    omega = 2.0 * math.pi / samples  # per period of 1 s
    z, force = 0.0, np.empty(samples)
    for k in range(4 * samples):
        velocity = deflection * omega * math.cos(omega * (k + 1))
        level, z = valve.friction(RUBBING, 1.0, z, velocity, 0.0, 1.0)
        force[k % samples] = level
    wave = np.exp(-1j * omega * np.arange(samples))
    return complex(2.0 / samples * np.sum(force * wave)) / (-1j * deflection)


@given(st.floats(-2.0, 1.5))
def test_describing_function_is_the_first_harmonic_of_the_bristles(exponent):
    deflection = 10.0**exponent
    found = complex(friction_swing.describing_function(np.array([deflection]))[0])
    assert first_harmonic(deflection, 4000) == pytest.approx(found, rel=0.01, abs=1e-5)


@pytest.mark.parametrize("frequency", [10.0, 30.0, 60.0])
@pytest.mark.parametrize("deflection", [0.2, 1.0])
def test_sampled_bristles_are_ahead_by_one_and_a_half_periods(frequency, deflection):
    samples = round(1.0 / (PERIOD * frequency))
    sampled = first_harmonic(deflection, samples)
    found = complex(friction_swing.describing_function(np.array([deflection]))[0])
    ahead = np.angle(sampled / found) * samples / (2.0 * math.pi)
    assert ahead == pytest.approx(friction_swing.AHEAD, abs=0.2)


def swings(law, params, plants):
    """Predicted amplitudes [V] of the swings in the loop, the valves' own included."""
    box = margins.prepared(plants)
    loop = -linear_loop.law_response(linear_loop.linear_law(law, params), box.z) * box.response
    return friction_swing.swings(loop, box.position, box.z, box.coulomb, box.presliding)


def rubbing(coulomb, presliding, delay=0.0005):
    """A valve on which the swings of GAINS were seen: slow poles, fast zeros, much gain."""
    made = comparison.made_of(
        1.35, 0.8, 1.22, delay, FREE._replace(coulomb=coulomb, presliding=presliding, flow_force=0.3)
    )
    return made._replace(lvdt=made.lvdt._replace(noise=0.0, resolution=0.0))


@pytest.mark.parametrize(
    ("coulomb", "presliding", "delay"), [(1.4, 0.035, 0.0005), (1.0, 0.03, 0.0), (1.0, 0.035, 0.0015)]
)
def test_predicted_swing_is_that_of_a_run(coulomb, presliding, delay):
    """The largest over the levels of friction up to the valve's own, after a step."""
    values = files.load(GAINS)["controller"]
    law = LAWS["pid"]
    params = law.build(updated(CONTROLLER, defaults(CONTROLLER), values))
    plants = [rubbing(share * coulomb, presliding, delay) for share in np.linspace(0.1, 1.0, 19)]
    predicted = swings(law, params, plants[-1:])[0]
    command = np.where(np.arange(6000) < 100, 0.0, 0.3)
    traces = np.empty((len(plants), len(command), 3))
    seeds = np.ones(len(plants), dtype=int)
    batch.simulate(batch.Batch(law.name, params, batch.records(plants), seeds, command), 1, traces)
    last = traces[:, -2000:, 0]
    amplitude = math.sqrt(2.0) * np.max(np.std(last, axis=1))
    assert predicted > 0.04
    assert amplitude == pytest.approx(predicted, rel=0.15)


def test_the_valves_own_swing_is_no_limit_cycle_of_the_loop():
    """The loop makes the swing of the valve little larger, above what counts as rest; margins say so too."""
    values = updated(CONTROLLER, defaults(CONTROLLER), files.load(GAINS)["controller"])
    law = LAWS["pid"]
    params = law.build(values)
    plants = [rubbing(1.4, 0.035), rubbing(1.4, 0.035)._replace(gain_scale=4.0)]
    box = margins.prepared(plants[:1])
    whole = swings(law, params, plants[:1])[0]
    assert box.own_swing[0] < whole < margins.GROWN * box.own_swing[0]
    assert margins.margins(law, params, box).swing_v[0] == pytest.approx(
        whole * (whole / box.own_swing[0] - 1.0) / (margins.GROWN - 1.0)
    )
