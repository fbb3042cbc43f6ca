# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What no margin shows: loops that come to rest at 0 V and not elsewhere, and pauses of the command."""

import math

import changed
import numpy as np
import pytest
import scipy.optimize

from research import comparison
from valve_control.control.laws import command_lead, reshaping
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.transfer_functions import FOURTH_ORDER
from valve_control.control.plant.valve import NO_DISTURBANCE
from valve_control.control.simulation import batch
from valve_control.design.tuning import checks, limits, trial
from valve_control.design.tuning.trial import GainSet, Problem, TuningMotion
from valve_control.parameter import defaults, updated

PERIOD = 0.001
GAINS = GainSet({}, 0.0)  # as they are
MOST = 12000.0  # V/s²
WIDE_BOUNDS = {"theta_min": [-1e6, -1e6, 980.0, -1e6], "theta_max": [1e6, 1e6, 1e6, 1e6]}
# Found by a search that looked at margins around 0 V alone: they are 31 dB and 40 degrees on this valve.
ADAPTING = {
    "oarc.k1": 656.1, "oarc.k2": 22780.0, "oarc.ks1": 600.0, "oarc.ks2": 60.02, "oarc.z2_weight": 1e4,
    "oarc.gamma": [11.31, 1.025, 176.4, 2261.0],
}  # fmt: skip
NUMBER = 1620  # of the valves of benchmarks.tuned, seed 20261122, on which they end in a limit cycle


def plant(**changes):
    return valve.design(FOURTH_ORDER, PERIOD, 10.0, 1.0, NO_DISTURBANCE, IDEAL)._replace(**changes)


def problem_of(law, plants, motions=(), **changes):
    values = updated(CONTROLLER, defaults(CONTROLLER), {"controller": law, **changes})
    return trial.Problem(values, list(motions), plants, plants, trial.USUAL, False, 1)


@pytest.mark.parametrize(("law", "position"), [("arc", -3.0), ("oarc", 1.5)])
def test_at_a_position_the_estimate_of_a0_integrates_like_that_of_a_disturbance(law, position):
    """u has θ̂2·x - θ̂4, and their rates are -γ2·x·z2 and γ4·z2: at rest γ2 acts like γ4 = γ2·x²."""

    def answer(gamma, height):
        own = {
            f"{law}.gamma": gamma,
            "controller": law,
            "reshaping.max_accel": 1e7,
            "reshaping.max_rate": 1e5,
        }
        own |= {f"{law}.{name}": bounds for name, bounds in WIDE_BOUNDS.items()}
        values = updated(CONTROLLER, defaults(CONTROLLER), own)
        command = np.where(np.arange(7000) < 5000, position, position + height)
        traces = np.empty((1, len(command), 3))
        batch.simulate(
            batch.Batch(
                law, LAWS[law].build(values), batch.records([plant()]), np.ones(1, int), command
            ),
            1,
            traces,
        )  # fmt: skip
        return traces[0, 4900:, 0] - position

    small, rate = 0.001, 4000.0 / position**2
    by_a0 = answer([0.0, rate, 0.0, 0.0], small)
    by_disturbance = answer([0.0, 0.0, 0.0, rate * position**2], small)
    none = answer([0.0, 0.0, 0.0, 0.0], small)
    assert np.max(np.abs(by_a0[:100])) < 1e-6  # at rest before the step
    # OARC has ξ0,2 in the place of x, which follows it through the K-filters.
    assert by_a0 == pytest.approx(by_disturbance, abs=0.02 * small)
    assert np.max(np.abs(none - by_disturbance)) > 0.1 * small


def test_margins_at_0_v_do_not_see_what_adaptation_does_elsewhere():
    """After 0.3 V the loop rests, after -1 V it swings with more than half a volt, though it has 20 dB."""
    plants = [comparison.valves(NUMBER + 1, 20261122, wide=True)[NUMBER]]
    problem = problem_of("oarc", plants, **ADAPTING)._replace(seed=NUMBER)
    law = LAWS["oarc"]
    params = law.build(problem.values)
    found = margins.margins(law, params, margins.prepared(plants))
    assert limits.violation(trial.USUAL, found) == 0.0 and found.gain_db[0] > 20.0
    command = checks.steps(PERIOD).wanted
    traces = np.empty((1, len(command), 3))
    batch.simulate(batch.Batch("oarc", params, batch.records(plants), np.array([NUMBER]), command), 1, traces)
    swings = [0.5 * float(np.ptp(traces[0, end - 500 : end, 0])) for end in (1100, 2100)]
    assert swings[0] < 0.02 and swings[1] > 0.5
    assert checks.after_all(law, problem, GAINS, plants).tolist() == [0]
    calm = problem_of("oarc", plants)
    assert checks.after_all(law, calm, GAINS, plants).tolist() == []


def test_what_rings_down_slowly_is_no_limit_cycle():
    """A PID whose loop loses 2 permille a sample still swings a second after a step, and rests after five."""
    loose = {"pid.form": "plain", "pid.ki": 0.0, "pid.kd": 0.0}
    law, box = LAWS["pid"], margins.prepared([plant()])

    def radius(kp):
        params = law.build(updated(CONTROLLER, defaults(CONTROLLER), {**loose, "pid.kp": kp}))
        return float(margins.margins(law, params, box).radius[0])

    for lost, shares, lasting in ((0.002, 1.0, []), (-0.002, 1.0, [0]), (0.02, 0.0, [])):
        kp = scipy.optimize.brentq(lambda kp, lost=lost: radius(kp) - (1.0 - lost), 3.0, 60.0)
        problem = problem_of("pid", [plant()], **loose, **{"pid.kp": kp})
        problem = problem._replace(limits=trial.TuningLimits(0.0, 0.0, 0.0, math.inf, math.inf, 1.0, 0.0))
        assert checks.restless_shares(law, problem, [GAINS]) == [shares]
        found = checks.after_all(law, problem, GAINS, [plant()], held=checks.LASTING)
        assert found.tolist() == lasting


def test_the_valves_own_swing_is_no_limit_cycle_of_the_loop():
    """It counts where the loop makes it much larger, or where the problem is strict and a node reports it."""
    loud = files.load("config/tuned/wide_0.25_pid_reference.yaml")["controller"]
    friction = NO_DISTURBANCE._replace(coulomb=1.4, presliding=0.035, flow_force=0.3)
    valve_of_it = comparison.made_of(1.35, 0.8, 1.22, 0.0005, friction)
    valve_of_it = valve_of_it._replace(lvdt=valve_of_it.lvdt._replace(noise=0.0, resolution=0.0))
    plants = [valve_of_it, valve_of_it._replace(gain_scale=4.0)]
    problem = problem_of("pid", plants, [trial.TuningMotion("rest", np.zeros(1000))], **loud)
    law, gains = LAWS["pid"], GAINS
    loops = trial.Loops(law, problem, [gains], plants, 1)
    command = checks.steps(PERIOD).wanted
    traces = np.empty((2, len(command), 3))
    loops.run(command, loops.commands(command), 1, traces=traces)
    assert np.all(checks.restless(traces[:, -1000:], PERIOD, 1.0)[0])
    assert checks.after_all(law, problem, gains, plants).tolist() == [1]
    swing = 0.5 * float(np.ptp(traces[0, -500:, 2]))
    for limit, counted in ((0.8 * swing, [0, 1]), (1.25 * swing, [1])):
        strict = problem._replace(values={**problem.values, "oscillation_limit": limit}, strict=True)
        assert checks.after_all(law, strict, gains, plants).tolist() == counted
        assert checks.after_all(law, strict._replace(strict=False), gains, plants).tolist() == [1]


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
