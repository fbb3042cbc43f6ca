# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The search: what it may choose, what it keeps, that it is repeatable; and what verification refuses."""

import math

import changed
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.laws import reshaping
from valve_control.control.laws.free import DIGITS, one, placed, present
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER, NODES
from valve_control.control.plant.transfer_functions import Scale
from valve_control.control.simulation import robustness
from valve_control.design.tuning import box, checks, limits, search, trial, tuner, verification
from valve_control.design.tuning.search import EvaluatedGains
from valve_control.design.tuning.trial import GainSet
from valve_control.parameter import defaults, updated

FREE = [free for law in LAWS.values() for free in law.free]
SETTINGS = {node: defaults(table) for node, table in NODES.items()}
LIMITS = trial.TuningLimits(2.0, 15.0, 0.0003, 12.0, 0.05, 0.02, 0.0)
NARROW = ("gain", "speed", "friction.coulomb")


def problem(law="pid", valves=4, seed=1, preview=False, **changes):
    values = changed.controller(controller=law, **changes)
    study = box.study_of(SETTINGS, [q for q in robustness.BOX if q.name in NARROW], valves, seed)
    times = np.maximum(0.0, np.arange(1200) * 0.001 - 0.05)
    wanted = 0.8 * np.sin(2.0 * math.pi * 5.0 * times) * np.clip(times / 0.2, 0.0, 1.0)
    motion = trial.TuningMotion("sine", wanted)
    return trial.Problem(values, [motion], box.drawn(study), box.bounding(study), LIMITS, preview, seed)


@pytest.mark.parametrize("law", [law for law in LAWS.values() if law.free], ids=lambda law: law.name)
def test_all_that_may_be_chosen_can_be_built(law):
    """Both ends and the middle of each range alone: accepted by the table, and found again in the values."""
    for variant in law.variants:
        values = updated(CONTROLLER, defaults(CONTROLLER), variant)
        for free in trial.free_numbers(law, values, preview=False):
            for share in (0.0, 0.5, 1.0):
                number = free.from_share(share)
                there = updated(CONTROLLER, values, placed([(free, number)], values))
                rounding = 0.0 if free.unit is one else 10.0 ** (1 - DIGITS)
                assert present(free, there) == pytest.approx(number, rel=rounding, abs=0.0)
                assert there != values or present(free, values) == present(free, there)


def test_a_range_goes_with_speed_and_gain_of_the_valve():
    """On a valve twice as fast and four times as strong; a number that comes from neither stays."""
    there = {free.name: free.ranged(Scale(2.0, 4.0)) for free in LAWS["pid"].free + LAWS["dcarc"].free}
    ends = {name: (free.low, free.high) for name, free in there.items()}
    assert ends["pid.kp"] == (0.3 / 4.0, 60.0 / 4.0) and ends["pid.kd"] == (3e-4 / 2.0, 0.03 / 2.0)
    assert ends["pid.theta[1]"] == (300.0 * 4.0, 5000.0 * 4.0)
    assert ends["dcarc.voltage_weight"] == (1e-3 * 16.0, 3.0 * 16.0)
    assert ends["dcarc.input_noise"] == (0.05, 10.0)


def test_a_known_motion_is_followed_without_lag():
    """Preview inverts the reshaping: the reference is the wanted motion."""
    p, law = problem("dcarc", preview=True), LAWS["dcarc"]
    sent = trial.Loops(law, p, [GainSet({}, 0.0)], p.plants, 1).commands(p.motions[0].wanted)[0]
    params, state, reference = law.build(p.values).reshaping, reshaping.State(0.0, 0.0), []
    for command in sent.tolist():
        reference.append(state.reference)
        state = reshaping.advance(params, state, reshaping.acceleration(params, state, command))
    assert np.max(np.abs(np.array(reference) - p.motions[0].wanted)) < 1e-9


@given(st.lists(st.tuples(st.floats(1e-3, 1.0), st.floats(1e-3, 1.0)), min_size=1, max_size=30))
def test_front_is_what_no_other_point_beats(pairs):
    points = [EvaluatedGains((), GainSet({}, 0.0), error, chatter, 0.0) for error, chatter in pairs]
    front = search.front(points)
    assert all(a.chatter > b.chatter and a.error < b.error for a, b in zip(front, front[1:], strict=False))
    for point in points:
        beaten = [p for p in front if p.error <= point.error and p.chatter <= point.chatter]
        assert beaten


@pytest.mark.parametrize("each", [1000, 100, 37], ids=["short run", "lone run", "runs from four places"])
def test_search_keeps_the_margins_and_is_the_same_on_any_number_of_threads(each, monkeypatch):
    monkeypatch.setattr(search, "EACH", each)
    monkeypatch.setattr(search, "EACH_COVARIANCE", 0)
    p = problem(pid__form="plain")
    told = []
    runs = [
        search.search(LAWS["pid"], p, search.phases(0.3), 150, 3, told.append, threads) for threads in (1, 2)
    ]
    assert runs[0] == runs[1]
    assert told[-1] == 150 <= runs[0].tried < 150 + search.LONE_POPULATION
    prepared = margins.prepared(p.box)
    for point in runs[0].points:
        params = LAWS["pid"].build(trial.values_with(p, point.gains))
        assert limits.violation(LIMITS, margins.margins(LAWS["pid"], params, prepared)) == 0.0
    assert runs[0].missed > 0
    gains = [point.gains for point in search.front(runs[0].points)]
    assert set(checks.restless_shares(LAWS["pid"], p, gains)) == {0.0}
    start = trial.run(LAWS["pid"], p, [GainSet({}, 0.0)])[0]
    best = min((q for q in runs[0].points if q.chatter <= 0.3), key=lambda q: q.error)
    assert best.error < 0.7 * start.error


def test_gains_bear_a_pause_of_the_command():
    """On a sine whose acceleration is half the limit; without the limit some of the front do not."""
    time = np.arange(2000) * 0.001
    wanted = np.sin(2.0 * np.pi * 12.0 * time) * np.clip(time / 0.2, 0.0, 1.0)
    there = problem("dcarc", valves=2)._replace(motions=[trial.TuningMotion("sine", wanted)])
    law, borne, chosen = LAWS["dcarc"], [], None
    for pause in (0.0, 0.01):
        asked = there._replace(limits=there.limits._replace(pause_s=pause))
        found = search.search(law, asked, [search.Phase(0.4, 1.0)], 150, 1, lambda done: None, 1)
        front = search.front(found.points)
        assert front
        found = checks.unborne(law, _bearing(there), [point.gains for point in front])
        borne.append([math.isinf(pause) for pause in found])
        chosen = chosen or next(p for p, bears in zip(front, borne[0], strict=True) if not bears)
    assert not all(borne[0]) and all(borne[1])
    unseen = _bearing(there)._replace(seed=7)
    reasons = verification.verified(law, unseen, chosen.gains, 0.4).reasons
    assert any("after a pause of the command of 10 ms or less" in reason for reason in reasons)


def _bearing(there):
    return there._replace(limits=there.limits._replace(pause_s=0.01))


def test_gains_without_margin_are_not_accepted(config):
    """Those tuned without spread fall into limit cycles on some valves of a box that has one."""
    values = files.load(str(config / "tuned" / "narrow_0.25_pid_plain.yaml"))["controller"]
    p = problem("pid", valves=24)._replace(values=updated(CONTROLLER, defaults(CONTROLLER), values))
    wide = [q for q in robustness.BOX if q.name in ("gain", "speed", "lvdt.delay")]
    study = box.study_of(SETTINGS, wide, 24, 7)
    p = p._replace(plants=box.drawn(study), box=box.bounding(study))
    found = verification.verified(LAWS["pid"], p, GainSet({}, 0.0), 0.25)
    assert len(found.restless) > 0
    assert any("unstable" in reason for reason in found.reasons)
    assert any("do not rest within 1 s" in reason for reason in found.reasons)


def test_what_swings_at_rest_is_told_from_what_creeps_and_from_noise():
    times = np.arange(1000) * 0.001
    noise = np.random.default_rng(1).normal(0.0, 0.008, 1000)
    positions = {
        "swings": (0.3 + 0.06 * np.sin(2.0 * math.pi * 30.0 * times) + noise, True),
        "creeps": (0.3 - 0.3 * np.exp(-times / 0.3) + noise, False),
        "creeps, and the valve swings": (
            0.3 - 0.9 * np.exp(-times / 0.3) + 0.017 * np.sin(2.0 * math.pi * 36.0 * times) + noise,
            False,
        ),
        "drifts": (0.3 + 0.3 * times + noise, False),
        "rests": (0.3 + noise, False),
        "is lost": (np.full(1000, math.nan), True),
    }
    for what, (position, swings) in positions.items():
        trace = np.stack([position, position, 0.5 + 20.0 * noise], axis=1)
        assert checks.restless(trace[None], 0.001, 1.0)[0] == swings, what
    voltage = 2.0 * np.sign(np.sin(2.0 * math.pi * 40.0 * times))
    assert all(checks.restless(np.stack([noise, noise, voltage], axis=1)[None], 0.001, 1.0))


@pytest.mark.parametrize(
    ("law", "own", "valve", "delays"),
    [
        ("dcarc", {}, {}, (0.001, 0.0)),  # the middle of the box
        ("dcarc", {"dcarc.delay": 0.0002}, {}, (0.0002, 0.0)),
        ("dcarc", {"dcarc.actuator_delay": 0.0015}, {}, (0.0, 0.0015)),
        ("dcarc", {"sample_period": 0.0001}, {}, (0.0, 0.0)),  # with which it cannot be built
        ("dcarc", {}, {"valve": "solenoid", "solenoid.dead_time": 0.0015}, (0.001, 0.0015)),
        ("pid", {}, {}, (0.0, 0.0)),
    ],
)
def test_a_law_is_told_the_dead_time_that_is_to_be_expected(law, own, valve, delays):
    """What was given stays."""
    late = [q for q in robustness.BOX if q.name == "lvdt.delay"]
    settings = {
        "controller": {**SETTINGS["controller"], **own},
        "valve_simulator": {**SETTINGS["valve_simulator"], **valve},
    }
    values, _ = box.with_dead_time(LAWS[law], settings, late)
    assert (values["dcarc.delay"], values["dcarc.actuator_delay"]) == delays


def test_a_limit_of_the_chatter_that_may_give_way_becomes_that_of_the_quieter_gains():
    """Gains beyond a firm one are not accepted; one that can be kept is kept, firm or not."""

    law, seen, unseen = LAWS["pid"], problem(valves=3), problem(valves=6, seed=2)

    def tuned(chatter, firm):
        return tuner.tuned(law, seen, unseen, chatter, 60, 1, lambda tried: None, firm=firm)

    assert any("above 0.0001" in reason for reason in tuned(0.0001, True).chosen.verified.reasons)
    made = tuned(0.0001, False)
    least = min(point.chatter for point in made.front)
    assert made.chatter == pytest.approx(tuner.QUIET * least)
    assert made.chosen.point.chatter <= made.chatter
    quiet = [p for p in made.front if p.chatter <= tuner.NEAR * made.chatter]
    assert not made.chosen.holds or made.chosen.point.error <= 1.5 * min(p.error for p in quiet)
    kept = tuned(5.0, False)
    assert kept.chatter == 5.0 and kept.chosen.point == tuned(5.0, True).chosen.point
