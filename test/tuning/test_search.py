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
from valve_control.control.laws.free import DIGITS, Free, one, placed, present
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER, NODES
from valve_control.control.simulation import robustness
from valve_control.design.tuning import box, limit_cycles, pauses, search, trial, tuner, verification
from valve_control.design.tuning.search import EvaluatedGains
from valve_control.design.tuning.trial import GainSet
from valve_control.parameter import defaults, updated

FREE = [free for law in LAWS.values() for free in law.free]
SETTINGS = {node: defaults(table) for node, table in NODES.items()}
LIMITS = trial.TuningLimits(2.0, 15.0, 0.0003, 12.0, 0.05, 0.02)
NARROW = ("gain", "speed", "friction.coulomb")


def problem(law="pid", valves=4, seed=1, preview=False, **changes):
    values = changed.controller(controller=law, **changes)
    study = box.study_of(SETTINGS, [q for q in robustness.BOX if q.name in NARROW], valves, seed)
    times = np.maximum(0.0, np.arange(1200) * 0.001 - 0.05)
    wanted = 0.8 * np.sin(2.0 * math.pi * 5.0 * times) * np.clip(times / 0.2, 0.0, 1.0)
    motion = trial.TuningMotion("sine", wanted)
    return trial.Problem(
        values,
        [motion],
        box.drawn(study),
        box.bounding(study),
        LIMITS,
        preview,
        False,
        seed,
    )


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


@given(free=st.sampled_from(FREE), share=st.floats(0.0, 1.0))
def test_shares_and_numbers_belong_together(free, share):
    number = free.from_share(share)
    assert free.low * 0.9995 <= number <= free.high * 1.0005
    again = free.from_share(free.to_share(number))
    assert again == pytest.approx(number, rel=2e-4, abs=1e-12)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_what_is_counted_in_another_number_keeps_its_ratio(kp, ratio, frequency):
    """The same share: the same integral and derivative time, and the same multiple of the lag of (8)."""
    values = updated(CONTROLLER, defaults(CONTROLLER), {"pid.form": "reference"})
    free = trial.free_numbers(LAWS["pid"], values, preview=False)
    shares = {"pid.kp": kp, "reshaping.natural_frequency": frequency}
    gains = trial.gains_at(free, values, [shares.get(f.name, ratio) for f in free]).changes
    made = updated(CONTROLLER, values, gains)
    counted = {f.name: f.from_share(ratio) for f in free}
    rounding = 10.0 ** (1 - DIGITS)
    assert made["pid.ki"] / made["pid.kp"] == pytest.approx(counted["pid.ki"], rel=rounding)
    assert made["pid.kd"] / made["pid.kp"] == pytest.approx(counted["pid.kd"], rel=rounding)
    lag = 1.6 / made["reshaping.natural_frequency"]
    assert made["reshaping.lead"] / lag == pytest.approx(counted["reshaping.lead"], rel=rounding)


class Counted:
    """What a run asks of the sets that were tried."""

    tried = 0


@pytest.mark.parametrize("best", search.LEVELS)
def test_a_run_holds_one_gain_and_tries_it_late_with_the_best_of_the_others(best):
    trials, seen = Counted(), []

    def judge(several, chatter, wall):
        trials.tried += len(several)
        seen.extend((trials.tried, shares[1]) for shares in several)
        costs = [float(np.sum((np.delete(x, 1) - 0.3) ** 2) + abs(x[1] - best)) for x in several]
        return search.Judged(costs, [True] * len(several))

    run = search._Run(np.array([0.5, 0.0, 0.5, 0.5]), 1, 0.2, seed=1)
    run.go(judge, 0.25, trials, 600, late=300)
    assert all(level == 0.0 for tried, level in seen if tried < 300)
    assert run._level == best
    assert run.best == pytest.approx([0.3, best, 0.3, 0.3], abs=0.02)


def test_followers_and_entries_of_lists_are_placed():
    first = Free("dcarc.presliding[0]", 0.002, 0.05, followers=(("dcarc.presliding[2]", 6.25),))
    second = Free("dcarc.presliding[1]", 0.002, 0.05)
    made = placed([(first, 0.01), (second, 0.02)], defaults(CONTROLLER))
    assert made == {"dcarc.presliding": [0.01, 0.02, 0.0625]}


@given(st.lists(st.tuples(st.floats(1e-3, 1.0), st.floats(1e-3, 1.0)), min_size=1, max_size=30))
def test_front_is_what_no_other_point_beats(pairs):
    points = [EvaluatedGains((), GainSet({}, 0.0), error, chatter, 0.0) for error, chatter in pairs]
    front = search.front(points)
    assert all(a.chatter > b.chatter and a.error < b.error for a, b in zip(front, front[1:], strict=False))
    for point in points:
        beaten = [p for p in front if p.error <= point.error and p.chatter <= point.chatter]
        assert beaten
    assert search.knee(front) in front


def test_knee_of_two_branches_is_their_corner():
    corner = [(1.0, 0.1), (0.5, 0.11), (0.1, 0.12), (0.09, 0.4), (0.08, 1.0)]
    points = [EvaluatedGains((), GainSet({}, 0.0), error, chatter, 0.0) for error, chatter in corner]
    assert search.knee(search.front(points)).error == 0.1


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
        assert trial.violation(LIMITS, margins.margins(LAWS["pid"], params, prepared)) == 0.0
    assert runs[0].missed > 0
    start = trial.run(LAWS["pid"], p, [GainSet({}, 0.0)])[0]
    best = min((q for q in runs[0].points if q.chatter <= 0.3), key=lambda q: q.error)
    assert best.error < 0.7 * trial.error_of(p, start)


@given(st.integers(0, 1000), st.integers(1, 12), st.integers(1, 5))
def test_a_search_begins_at_the_best_places_that_are_apart(seed, n, count):
    random = np.random.default_rng(seed)
    places, costs = list(random.random((40, n))), list(random.random(40))
    starts = search._starts(places, costs, count)
    assert np.array_equal(starts[0], places[int(np.argmin(costs))]) and len(starts) <= count

    def near(a, b):
        return np.sqrt(np.mean((a - b) ** 2)) <= search.APART

    assert not any(near(a, b) for i, a in enumerate(starts) for b in starts[:i])
    worst = max(c for place, c in zip(places, costs, strict=True) if any(place is s for s in starts))
    for place, cost in zip(places, costs, strict=True):  # one that is better was too near to one chosen
        assert cost > worst or any(place is s or near(place, s) for s in starts) or len(starts) < count


def test_cost_goes_on_beyond_a_margin():
    """Just inside and just outside of a limit the search sees nearly the same cost, and no point outside."""
    law, p = LAWS["pid"], problem(pid__form="plain")
    free = trial.free_numbers(law, p.values, False)
    shares = np.array([f.to_share(present(f, p.values)) if f is not trial.AHEAD else 0.0 for f in free])
    params = law.build(trial.values_with(p, trial.gains_at(free, p.values, list(shares))))
    found = margins.margins(law, params, margins.prepared(p.box))
    least = float(np.min(found.phase_deg)) * search.BACK_OFF
    costs = []
    for wanted in (0.999 * least, 1.001 * least):
        there = p._replace(limits=trial.TuningLimits(0.0, wanted, 0.0, math.inf, math.inf, 1.0))
        trials = search._Trials(law, there, free, 1)
        costs += trials.judged([shares], 1.0).costs
        assert len(trials.points) == (wanted < least)
    assert 0.0 < costs[1] - costs[0] < 0.01


@pytest.mark.parametrize("resting", ["all", "four of five", "all but the first"])
def test_what_would_be_the_best_is_asked_whether_it_rests(resting, monkeypatch):
    """After one that did not rest, those near the best are asked too, for a while."""
    limit, budget, done = 0.3, 240, [0]
    asked, together, real = {}, [], limit_cycles.restless_shares

    def restless(law, problem, several, workers=None):
        if done[-1] < budget:  # at the end the front is asked
            together.append((done[-1], [repr(gains) for gains in several]))
        for gains, share in zip(several, real(law, problem, several, workers), strict=True):
            number = len(asked)
            moves = {"all": False, "four of five": number % 5 == 4, "all but the first": number == 0}[resting]
            asked[repr(gains)] = 1.0 if moves else share
        return [asked[repr(gains)] for gains in several]

    monkeypatch.setattr(limit_cycles, "restless_shares", restless)
    there = problem("pid")
    found = search.search(LAWS["pid"], there, [search.Phase(limit, 1.0)], budget, 1, done.append, 1)
    assert all(asked[repr(point.gains)] == 0.0 for point in search.front(found.points))
    costs = {repr(p.gains): search.cost(p, limit, there.limits.saturated) for p in found.points}
    least, order = math.inf, list(costs)
    for gains, cost in costs.items():
        assert cost > least or gains in asked
        least = min(least, cost)
    beyond = []  # the least of all before them, of those that rest, and after how many sets
    for tried, several in together:
        rest = [gains for gains in several if gains in costs]
        before = order[: order.index(rest[0])] if rest else []
        most = min((costs[gains] for gains in before), default=math.inf)
        beyond += [(tried, costs[gains] - most) for gains in rest]
    assert max(over for _, over in beyond) <= search.CLOSE
    last = max((tried for tried, over in beyond if over > 0.0), default=None)
    if resting == "all":
        assert last is None
    elif resting == "four of five":
        assert last > budget / 2
    else:
        assert 0 < last < done[1] + 100
        assert any(tried > last for tried, _ in beyond)  # some were asked after it


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
        borne.append([pauses.borne(law, _bearing(there), point.gains) for point in front])
        chosen = chosen or next(p for p, bears in zip(front, borne[0], strict=True) if not bears)
    assert not all(borne[0]) and all(borne[1])
    unseen = _bearing(there)._replace(seed=7)
    reasons = verification.verified(law, unseen, chosen.gains, 0.4).reasons
    assert any("after a pause of the command of 10 ms or less" in reason for reason in reasons)


def _bearing(there):
    return there._replace(limits=there.limits._replace(pause_s=0.01))


def test_a_known_motion_is_followed_without_lag():
    """Preview inverts the reshaping: the reference of every law that reshapes is the wanted motion."""
    p = problem("dcarc", preview=True)
    law = LAWS["dcarc"]
    params = law.build(p.values)
    sent = trial.given(law, params, p.values, GainSet({}, 0.0), p, p.motions[0].wanted)
    state, reference = reshaping.State(0.0, 0.0), []
    for command in sent.tolist():
        reference.append(state.reference)
        accel = reshaping.acceleration(params.reshaping, state, command)
        state = reshaping.advance(params.reshaping, state, accel)
    assert np.max(np.abs(np.array(reference) - p.motions[0].wanted)) < 1e-9


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


def test_variants_are_those_that_were_not_decided():
    law = LAWS["pid"]
    assert len(tuner.variants(law, defaults(CONTROLLER))) == 2
    plain = updated(CONTROLLER, defaults(CONTROLLER), {"pid.form": "plain"})
    assert [v["pid.form"] for v in tuner.variants(law, plain)] == ["plain"]
    placed_poles = updated(CONTROLLER, defaults(CONTROLLER), {"pid.break_frequency": 9.0})
    assert all(v["pid.break_frequency"] == 0.0 for v in tuner.variants(law, placed_poles))


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
        assert limit_cycles.restless(trace[None], 0.001, 1.0) == swings, what
    voltage = 2.0 * np.sign(np.sin(2.0 * math.pi * 40.0 * times))
    assert limit_cycles.restless(np.stack([noise, noise, voltage], axis=1)[None], 0.001, 1.0)


def test_a_law_is_told_the_dead_time_that_is_to_be_expected():
    """Middle of the box or that of the valve; what was given stays, and what cannot be built is left out."""
    dcarc = LAWS["dcarc"]
    late = [q for q in robustness.BOX if q.name == "lvdt.delay"]
    middle = 0.5 * (late[0].low + late[0].high)
    assert box.with_dead_time(dcarc, SETTINGS, late) == (
        {**SETTINGS["controller"], "dcarc.delay": middle},
        middle,
    )
    assert box.with_dead_time(dcarc, SETTINGS, []) == (SETTINGS["controller"], None)
    own = {**SETTINGS, "valve_simulator": {**SETTINGS["valve_simulator"], "lvdt.delay": 0.0004}}
    assert box.with_dead_time(dcarc, own, [])[0]["dcarc.delay"] == 0.0004
    given_ = {**SETTINGS, "controller": {**SETTINGS["controller"], "dcarc.delay": 0.0002}}
    assert box.with_dead_time(dcarc, given_, late) == (given_["controller"], None)
    before = {**SETTINGS, "controller": {**SETTINGS["controller"], "dcarc.actuator_delay": 0.0015}}
    assert box.with_dead_time(dcarc, before, late) == (before["controller"], None)
    fast = {**SETTINGS, "controller": {**SETTINGS["controller"], "sample_period": 0.0001}}
    assert box.with_dead_time(dcarc, fast, late) == (fast["controller"], None)
    assert box.with_dead_time(LAWS["pid"], SETTINGS, late) == (SETTINGS["controller"], None)
    magnet = {"valve": "solenoid", "solenoid.dead_time": 0.0015}
    known = {**SETTINGS, "valve_simulator": {**SETTINGS["valve_simulator"], **magnet}}
    told = box.with_dead_time(dcarc, known, late)[0]
    assert (told["dcarc.actuator_delay"], told["dcarc.delay"]) == (0.0015, middle)


def test_a_limit_of_the_chatter_that_may_give_way_becomes_that_of_the_quieter_gains():
    """Gains beyond a firm one are not accepted; one that can be kept is kept, firm or not."""

    def told(tried):
        pass

    law, seen, unseen = LAWS["pid"], problem(valves=3), problem(valves=6, seed=2)

    def tuned(chatter, firm):
        return tuner.tuned(law, seen, unseen, tuner.Aim(chatter, None, firm), 60, 1, told)

    assert any("above 0.0001" in reason for reason in tuned(0.0001, True).chosen.verified.reasons)
    made = tuned(0.0001, False)
    least = min(point.chatter for _, point in made.front)
    assert made.chatter == pytest.approx(tuner.QUIET * least)
    assert made.chosen.point.chatter <= made.chatter
    quiet = [p for _, p in made.front if p.chatter <= tuner.NEAR * made.chatter]
    assert not made.chosen.holds or made.chosen.point.error <= 1.5 * min(p.error for p in quiet)
    kept = tuned(5.0, False)
    assert kept.chatter == 5.0 and kept.chosen.point == tuned(5.0, True).chosen.point
