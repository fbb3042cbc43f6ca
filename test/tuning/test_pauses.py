# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A pause of the command: whether the reference comes back, or stays on the large answer of the reshaping."""

import math

import changed
import numpy as np
import pytest

from valve_control.control.laws import command_lead, reshaping
from valve_control.control.laws.registry import LAWS
from valve_control.design.tuning import checks, trial
from valve_control.design.tuning.trial import GainSet, Problem, TuningMotion

PERIOD = 0.001
GAINS = GainSet({}, 0.0)  # as they are
MOST = 12000.0  # V/s²


def sine(amplitude, frequency, seconds=3.0):
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    return amplitude * np.sin(2.0 * np.pi * frequency * time) * np.clip(time / 0.2, 0.0, 1.0)


def problem(wanted, law="dcarc", **changes):
    values = changed.controller(controller=law, **changes)
    return Problem(
        values, [TuningMotion("wanted", wanted)], [], [], trial.USUAL._replace(pause_s=0.05), False, 1
    )


def shortest(wanted, law="dcarc", **changes):
    return checks.unborne(LAWS[law], problem(wanted, law, **changes), [GAINS])[0]


def reference(commands, **changes):
    """In plain Python, by the functions that the laws use."""
    values = problem(commands, **changes).values
    led = command_lead.applied(command_lead.build(values, True), commands)
    p, state, made = reshaping.build(values), reshaping.State(0.0, 0.0), []
    for command in led.tolist():
        made.append(state.reference)
        state = reshaping.advance(p, state, reshaping.acceleration(p, state, command))
    return np.array(made)


# Motion, reshaping, distance [V] of the reference after a pause of 0, 5, 10, 20 ms:
# docs/explanation/laws/reshaping.md
TABLE = [
    (1.0, 12.0, 800.0, 0.0019, (0.03, 0.03, 3.7, 3.8)),
    (1.0, 12.0, 500.0, 0.003, (0.06, 0.06, 0.06, 3.5)),
    (1.0, 12.0, 314.0, 0.005, (0.11, 0.11, 0.11, 0.11)),
    (0.39, 20.0, 800.0, 0.0019, (0.03, 1.5, 1.6, 1.7)),
    (0.39, 20.0, 500.0, 0.003, (0.06, 0.06, 0.06, 0.06)),
    (0.3, 15.0, 800.0, 0.0019, (0.02, 0.02, 0.02, 0.02)),
]


@pytest.mark.parametrize("amplitude, frequency, natural_frequency, lead, away", TABLE)
def test_one_pause_leads_a_fast_reshaping_to_an_answer_of_several_times_the_size(
    amplitude, frequency, natural_frequency, lead, away
):
    wanted = sine(amplitude, frequency)
    settings = {"reshaping__natural_frequency": natural_frequency, "reshaping__lead": lead}
    for pause, expected in zip((0, 5, 10, 20), away, strict=True):
        late = wanted.copy()
        late[1000 : 1000 + pause] = wanted[999]
        found = float(np.max(np.abs(reference(late, **settings) - wanted)[2500:]))
        assert found == pytest.approx(expected, abs=0.05 if expected > 1.0 else 0.006)
        # Of the places that are tried one at least is as bad as this one.
        assert expected < 1.0 or shortest(wanted, **settings) <= 0.001 * pause


def large_answer_lasts(natural_frequency, damping, amplitude, frequency):
    """Begun at any phase of the command."""
    p = reshaping.Params(natural_frequency, damping, 250.0, MOST, PERIOD)
    w = 2.0 * np.pi * frequency
    large = 4.0 / np.pi * MOST / w**2
    for phase in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        commands = amplitude * np.sin(w * PERIOD * np.arange(1500) + phase)
        state, seen = reshaping.State(0.0, -large * w), []
        for command in commands.tolist():
            state = reshaping.advance(p, state, reshaping.acceleration(p, state, command))
            seen.append(abs(state.reference))
        if max(seen[-200:]) > 0.5 * large:
            return True
    return False


@pytest.mark.parametrize("natural_frequency", [800.0, 500.0, 314.0])
@pytest.mark.parametrize("frequency", [13.0, 16.0, 20.0])
def test_the_large_answer_exists_from_where_the_describing_function_says(natural_frequency, frequency):
    """A·ω²/M from (4/π)·ω·(2·ξ/ω_n - ΔT/2) on: simulated within a quarter of it, where (7) is not met."""
    damping, w = 0.8, 2.0 * np.pi * frequency
    least = 4.0 / np.pi * w * (2.0 * damping / natural_frequency - 0.5 * PERIOD)
    for factor, lasts in ((0.75, False), (1.25, True)):
        amplitude = factor * least * MOST / w**2
        assert large_answer_lasts(natural_frequency, damping, amplitude, frequency) == lasts, factor


def test_what_is_not_reshaped_and_what_is_known_ahead_is_not_looked_at():
    wanted = sine(1.0, 12.0)
    settings = {"reshaping__natural_frequency": 800.0}
    assert shortest(wanted, **settings) < math.inf
    assert shortest(wanted, "pid", pid__form="plain", **settings) == math.inf
    reshaped = problem(wanted, **settings)
    none = trial.USUAL._replace(pause_s=0.0)
    for other in (reshaped._replace(preview=True), reshaped._replace(limits=none)):
        assert checks.unborne(LAWS["dcarc"], other, [GAINS]) == [math.inf]
