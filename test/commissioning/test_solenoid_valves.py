# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark on random solenoid valves: its box, its bench, what it keeps and what it refuses."""

import json
import math

import numpy as np
import pytest

from benchmarks import solenoid
from benchmarks.supervised import SupervisedValve
from valve_control.control.compiling import sources_digest
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.simulation import offline
from valve_control.design.commissioning.bench import SafetyLimits
from valve_control.parameter import defaults, updated

QUICK = solenoid.Options(budget=20, sets=20)


def test_the_box_is_that_of_the_issue_and_used_whole():
    valves = [solenoid.drawn(seed) for seed in range(1, 1001)]
    dead = [v["solenoid.dead_time"] + v["lvdt.delay"] for v in valves]
    for given, low, high in (
        ([v["solenoid.natural_frequency"] for v in valves], 5.0, 60.0),
        ([v["solenoid.damping"] for v in valves], 0.5, 1.2),
        ([v["solenoid.coil"] for v in valves], 0.0005, 0.006),
        ([v["solenoid.hysteresis"] for v in valves], 0.0, 0.8),
        ([v["solenoid.positive"] for v in valves], 0.9, 1.1),
        ([v["friction.coulomb"] for v in valves], 0.0, 1.4),
        ([v["friction.presliding"] for v in valves], 0.005, 0.04),
        ([v["disturbance.offset"] for v in valves], -0.3, 0.3),
        ([v["flow_force"] for v in valves], 0.0, 0.15),
        (dead, 0.0, 0.0015),
        ([v["lvdt.noise"] for v in valves], 0.001, 0.006),
        ([v["solenoid.hum"] for v in valves], 0.0, 0.005),
        ([v["solenoid.bits"] for v in valves], 12, 16),
    ):
        assert low <= min(given) < low + 0.03 * (high - low)
        assert high - 0.05 * (high - low) < max(given) <= high
    shares = [v["lvdt.delay"] / whole for v, whole in zip(valves, dead, strict=True)]
    assert np.mean(shares) == pytest.approx(0.5, abs=0.03)
    frequencies = [v["solenoid.natural_frequency"] for v in valves]
    # Logarithmic: standard deviation of the mean logarithm is log(12)/√12/√1000 = 0.023.
    assert np.mean(np.log(frequencies)) == pytest.approx(0.5 * math.log(5.0 * 60.0), abs=0.07)


def test_a_seed_is_a_valve():
    assert solenoid.drawn(7) == solenoid.drawn(7) != solenoid.drawn(8)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_bench_is_the_simulated_valve(seed):
    """The same readings, bit for bit, as those of an offline run."""
    values = solenoid.drawn(seed)
    bench = SupervisedValve(values, {"controller": "open_loop", "open_loop.static_gain": 1.0})
    wanted = [2.0 * math.sin(0.02 * k) for k in range(600)]
    record = bench.drive((value for value in wanted), SafetyLimits(10.0, 10.0), lambda done: None)
    controller = updated(CONTROLLER, defaults(CONTROLLER), bench.controller)
    run = offline.simulate(controller, values, np.array(wanted))
    assert record.voltage.tolist() == run.voltage.tolist()
    assert record.reading.tolist() == run.measurement.tolist()
    assert np.ptp(record.reading) > 0.3


def test_the_reference_is_kept_as_long_as_its_figures_are_true():
    values = solenoid.drawn(1)
    first = solenoid.reference(values, QUICK, None)
    for mode in solenoid.MODES:
        assert 0.0 < first[mode]["e_rms"] < 1.0 and first[mode]["form"] in solenoid.FORMS
    assert solenoid.reference(values, QUICK, first) == first
    wrong = {**first, "command alone": {**first["command alone"], "e_rms": 0.001}}
    again = solenoid.reference(values, QUICK, wrong)
    assert again["command alone"] == first["command alone"]


@pytest.mark.campaign
def test_more_sets_of_gains_are_no_worse():
    """On what the search sees; full motions may differ."""
    values = solenoid.drawn(2)
    few, many = (solenoid.reference(values, solenoid.Options(20, sets), None) for sets in (20, 200))
    for mode in solenoid.MODES:
        assert many[mode]["c_u"] <= 1.1 * solenoid.CHATTER
        if few[mode]["c_u"] <= solenoid.CHATTER:
            assert many[mode]["e_rms"] < 1.05 * few[mode]["e_rms"]


def row(seed, **laws):
    best = {mode: {"e_rms": 0.02, "c_u": 0.2} for mode in solenoid.MODES}
    return {
        "options": {**QUICK._asdict(), "seed": seed},
        "valve": solenoid.drawn(seed),
        "reference": {**best, "cpu_s": 1.0},
        "robustness": {
            "with preview": dict.fromkeys(solenoid.ROBUST, True),
            "command alone": dict.fromkeys(solenoid.ROBUST, False),
        },
        "laws": laws,
    }


def accepted(e_rms, c_u=0.2, error=1.0, cycle=False):
    return {
        "accepted": True,
        "cpu_s": 2.0,
        "running_c_u": c_u,
        "modes": {mode: {"e_rms": e_rms, "c_u": c_u} for mode in solenoid.MODES},
        "valve": {"error": error},
        "limit_cycle": cycle,
    }


REFUSED = {"accepted": False, "reason": "friction takes up the sine", "step": "model", "cpu_s": 1.0}


def test_targets_are_judged_by_what_was_measured():
    rows = [
        row(1, dcarc=accepted(0.008), pid=accepted(0.03)),
        row(2, dcarc=accepted(0.012, c_u=0.35, error=4.0, cycle=True), pid=accepted(0.022)),
        row(3, dcarc=REFUSED, pid=REFUSED),
    ]
    found = {target.name: target for target in solenoid.targets(rows)}
    assert found["dcarc, with preview: median ratio"].value == pytest.approx(0.5)
    assert found["dcarc, command alone: largest ratio"].value == pytest.approx(0.6)
    assert found["pid, with preview: largest ratio"].value == pytest.approx(1.5)
    assert not found["pid, with preview: largest ratio"].reached
    assert found["dcarc: largest c_u over its limit"].value == pytest.approx(1.4)
    assert found["share of valves with a model error of 3 or less"].value == pytest.approx(1 / 3)
    assert found["dcarc: limit cycles"].value == 1.0
    assert not found["dcarc: share of valves accepted"].reached
    lines = "\n".join(line for one in rows for line in solenoid.told(one))
    assert all(line.endswith(": 3 of 6") for line in solenoid.summary(rows)[-len(solenoid.ROBUST) :])
    assert "0.40/0.40" in lines and "dcarc refused in step 'model': friction takes up the sine" in lines


@pytest.mark.parametrize(("kp", "kept"), [(0.05, True), (50.0, False)])
def test_a_slow_pid_is_robust_and_a_fast_one_is_not(kp, kept):
    """The loop of ki/s and a valve has a gain margin without end as kp goes to 0."""
    values = {"pid.form": "plain", "pid.break_frequency": 0.0, "pid.kp": kp, "pid.ki": kp, "pid.kd": 0.0}
    found = dict.fromkeys(solenoid.MODES, {"values": values})
    for one in solenoid.robustness(solenoid.drawn(1), found).values():
        assert one == dict.fromkeys(solenoid.ROBUST, kept)


def test_the_surroundings_of_a_valve_are_those_of_its_commissioning():
    """A tenth of its gain to either side, and later readings."""
    values = {**solenoid.drawn(1), "lvdt.noise": 0.0}
    gains = [p.spool.gain for p in solenoid.surroundings(values)]
    assert min(gains) == pytest.approx(0.9 * 0.9) and max(gains) == pytest.approx(1.1 * 0.9)


def test_the_best_pid_keeps_the_margins_that_are_asked_for():
    values = solenoid.drawn(5)  # on which the best PID without margins is unstable without friction
    gains = solenoid.searched(values, "plain", False, solenoid.Options(20, 160, "valve"))
    own = {**solenoid.FORMS["plain"], **gains.changes}
    kept = solenoid.robustness(values, dict.fromkeys(solenoid.MODES, {"values": own}))["command alone"]
    assert kept["stable"] and kept["margins"]


def test_nothing_accepted_reaches_nothing():
    found = {t.name: t for t in solenoid.targets([row(1, dcarc=REFUSED, pid=REFUSED)])}
    assert not found["dcarc, with preview: median ratio"].reached
    assert not found["dcarc: largest c_u over its limit"].reached


def test_what_is_done_is_not_done_again(tmp_path):
    reference = solenoid.reference(solenoid.drawn(3), QUICK, None)
    laws = {"dcarc": REFUSED, "pid": REFUSED}
    kept = {
        **row(3),
        "reference": reference,
        "laws": laws,
        "options": {**QUICK._asdict(), "seed": 3},
        "sources": sources_digest(),
    }
    (tmp_path / "3.json").write_text(json.dumps(kept))
    made = solenoid.gone_through(tmp_path, 3, QUICK)
    assert made["laws"] == laws and made["reference"] == reference


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--valves", "0"], "--valves is 0; it must lie between 1 and 999"),
        (["--seed", "0"], "--seed is 0; it must be 1 or more"),
        (["--seed", "995", "--valves", "6"], "reaches from the valves of development to the unseen ones"),
        (["--budget", "0"], "--budget is 0; it must lie between 1 and 1000000"),
        (["--sets", "-3"], "--sets is -3; it must lie between 1 and 1000000"),
        (["--jobs", "0"], "--jobs is 0; it must lie between 1 and"),
        (["--seed", "1.5"], "invalid int value"),
    ],
)
def test_bad_input_is_one_sentence(arguments, words, capsys, tmp_path):
    try:
        status = solenoid.main([*arguments, "--out", str(tmp_path / "made")])
    except SystemExit as ended:
        status = ended.code
    said = capsys.readouterr().err
    assert status == 2 and words in said and said.count("\n") == 1
    assert not (tmp_path / "made").exists()


@pytest.mark.campaign
def test_one_valve_goes_all_the_way(tmp_path, capsys):
    out = str(tmp_path)
    arguments = ["--valves", "1", "--seed", "2", "--budget", "40", "--sets", "40", "--out", out]
    assert solenoid.main(arguments) == 0
    first = capsys.readouterr().out
    result = json.loads((tmp_path / "solenoid.json").read_text())
    assert result["valves"] == 1 and not result["unseen"]
    (made,) = result["rows"]
    assert made["laws"].keys() == {"dcarc", "pid"}
    for law in made["laws"].values():
        assert law["accepted"] or law["reason"]
    assert "reached" in first
    assert solenoid.main(arguments) == 0
    assert capsys.readouterr().out == first  # nothing is done again: the seconds are the same too
