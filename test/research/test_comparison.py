# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Laws with tuned gains on random valves: what is compared, and with what."""

import numpy as np
import pytest

from research import comparison
from research.comparison import Setup
from valve_control.control.laws import reshaping
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import ros_file
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.simulation import batch, delivery
from valve_control.parameter import defaults, updated

TUNED = ros_file.config_folder() / "tuned"


def test_unreshaped_commands_make_the_reference_the_wanted_motion():
    """Through the law's own reshaping (8)-(11), which reaches the motion to rounding."""
    values = updated(
        CONTROLLER,
        defaults(CONTROLLER),
        {**comparison.NO_LIMITS, "controller": "oarc", "reshaping.natural_frequency": 350.0},
    )
    law = LAWS["oarc"]
    params = law.build(values)
    for name, wanted in comparison.motions().items():
        shaping = params.reshaping
        sent = delivery.unreshaped(shaping, wanted)
        state, reached = reshaping.State(wanted[0], 0.0), []
        for command in sent:
            reached.append(state.reference)
            state = reshaping.advance(shaping, state, reshaping.acceleration(shaping, state, command))
        assert np.max(np.abs(np.array(reached) - wanted[:-2])) < 1e-9, name


def test_errors_of_one_valve_are_those_of_its_own_run():
    """A setup a plant, as a batch of different laws' gains, against each one alone."""
    plants = batch.records(comparison.valves(3, 5, True))
    setups = [Setup("dcarc", {"controller": "dcarc", "dcarc.delay": d}, 0.0) for d in (0.0, 3e-4, 1e-3)]
    together = comparison.measured(setups, plants, 7)
    alone = comparison.measured(setups[1], plants, 7)
    assert np.array_equal(together.rms[:, 1], alone.rms[:, 1])
    assert not np.array_equal(together.rms[:, 2], alone.rms[:, 2])


@pytest.mark.parametrize(("limit", "most"), [(0.25, 0.36), (0.1, 0.45)])
def test_order_of_laws_on_valves_that_were_not_tuned_on(limit, most):
    """The oracle leads, dcarc has at most ``most`` of the better PID's error, and a lag costs every law."""
    found = comparison.compare(comparison.setups(TUNED, "narrow", limit), 8, 31, False)
    size = {
        text: {name: comparison.geometric(np.median(e.rms, axis=1)) for name, e in by_name.items()}
        for text, by_name in found.items()
    }
    ahead, bare = size["with preview"], size["command alone"]
    assert min(ahead, key=ahead.__getitem__) == comparison.ORACLE
    assert ahead["dcarc"] <= most * min(ahead["pid_plain"], ahead["pid_reference"])
    assert all(bare[name] > 1.5 * ahead[name] for name in ahead)
    # At equal chatter, by which alone errors compare.
    for name, errors in found["with preview"].items():
        assert name == comparison.ORACLE or 0.8 * limit < np.mean(errors.chatter) < 1.08 * limit
