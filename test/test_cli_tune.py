# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""valve-control tune: the contract for scripts, files that go straight into simulate, refusals."""

import json
import math

import numpy as np
import pytest
from said import sentences

from benchmarks import invented
from valve_control.cli import command, tune
from valve_control.control.parameters import files, ros_file
from valve_control.design.tuning import trial

FIXED = ["gain", "flow_force", "disturbance.offset", "friction.static_ratio", "lvdt.delay"]
FIXED += ["drift.gain", "drift.stiffness"]
SMALL = [option for name in FIXED for option in ("--fix", name)]
SMALL += ["--valves", "3", "--unseen", "4", "--budget", "60", "--seed", "2", "--max-chatter", "0.6"]


def limits(*options):
    return tune.limits_of(command.Commands().top.parse_args(["tune", *options]))


def test_what_has_to_hold_is_what_commission_asks_for_too():
    """But for the overshoot, which commission leaves open, as its reference has the paper's form."""
    assert limits().overshoot == 0.05 and limits()._replace(overshoot=math.inf) == trial.USUAL
    off = limits(*(f"--{name}=none" for name, *_ in tune.LIMITS.values()))
    assert off == trial.TuningLimits(0.0, 0.0, 0.0, math.inf, math.inf, math.inf, 0.0, math.inf)
    zero = limits("--saturation", "0", "--overshoot", "0")
    assert (zero.saturated, zero.overshoot) == (0.0, 0.0)


@pytest.fixture
def commands(tmp_path):
    """Options that name two commands."""
    times = np.arange(1100) * 0.001
    swell = np.clip(times / 0.3, 0.0, 1.0)
    named = []
    for name, frequency in (("a.csv", 2.0), ("b.csv", 5.0)):
        np.savetxt(tmp_path / name, 0.8 * swell * np.sin(2.0 * np.pi * frequency * times))
        named += ["--command", name]
    return named


def test_one_json_object_and_a_file_for_each_law(run, tmp_path, commands):
    few = [*commands, *SMALL, "--output", "t.yaml", "--json", "-"]
    status, out, err = run("tune", "--controller", "dcarc,pid", *few)
    assert status == 0, err
    result = json.loads(out)
    assert list(result["laws"]) == ["dcarc", "pid"]
    for name, law in result["laws"].items():
        assert law["accepted"] and law["file"] == f"t_{name}.yaml"
        assert law["verified"]["e_rms"]["median"] <= law["verified"]["e_rms"]["p95"]
        assert law["verified"]["c_u"] <= 0.6 * 1.05 and law["verified"]["restless"] == 0
        worst = law["margins"]
        assert worst["gain_db"] >= 3.0 and worst["phase_deg"] >= 20.0 and worst["delay_s"] >= 0.0005
        chatter = [point["chatter"] for point in law["front"]]
        assert chatter == sorted(chatter, reverse=True)
        written = files.load(law["file"])["controller"]
        assert written["controller"] == name
        assert all(written[parameter] == value for parameter, value in law["chosen"].items())
        status, out, err = run("simulate", "--params-file", law["file"], *commands[:2], "--json", "-")
        alone = json.loads(out)
        assert status == 0 and alone["controller"] == name and alone["warning"] is None
        assert alone["true_error"]["e_rms"] < 0.1


@pytest.mark.parametrize(
    ("law", "valve", "own", "words"),
    [
        ("dcarc", "[1.0, 300.0, 48000.0]", [], "note: dcarc.model is that of the valve, custom"),
        ("dcarc", "[1.0, 300.0, 48000.0]", ["--set", "dcarc.model=second_order"], ""),
    ],
)
def test_a_law_gets_the_model_of_the_valve_that_is_given(run, commands, law, valve, own, words):
    """Or says that it keeps another; a model that was chosen stays without a word."""
    given = ["--set", "valve=custom", "--set", "numerator=[48000.0]", "--set", f"denominator={valve}"]
    few = [*SMALL, "--budget", "1", "--valves", "1", "--unseen", "1", "--json", "-"]
    _, _, err = run("tune", "--controller", law, *commands, *given, *own, *few)
    assert words in err and ("dcarc.model" in err) == (law == "dcarc" and bool(words)), err


NEVER = ["--gain-margin", "60"]  # which no set keeps


def test_what_does_not_hold_is_not_written(run, tmp_path, commands):
    """The nearest to a margin that no set keeps: a result with its reasons, and no file."""
    few = [*SMALL, "--budget", "24"]
    status, out, err = run(
        "tune", "--controller", "pid", *commands, *few, *NEVER, "--output", "t.yaml", "--json", "-"
    )
    law = json.loads(out)["laws"]["pid"]
    assert status == 1 and not law["accepted"] and law["file"] is None and law["chosen"]
    assert "pid: not accepted, because the gain margin falls to" in err and not (tmp_path / "t.yaml").exists()
    assert "margins with --box shows where" in err
    row = next(row for row in law["limits"] if row["limit"] == "gain margin")
    assert row["missed"] == row["looked_at"] >= 24 and row["best"] < row["wanted"] == 60.0
    counted = f"{row['missed']} of {row['missed']} sets of gains miss it, the best has {row['best']:.3g} dB"
    assert f"pid: the gain margin binds: {counted} (>= 60 dB)" in err


def test_gains_without_a_file_are_printed(run, tmp_path, commands):
    """And nothing hides what else is wrong with the command line."""
    status, out, err = run("tune", "--controller", "pid", *commands, *SMALL, "--budget", "24")
    assert status == 0, err
    (tmp_path / "printed.yaml").write_text(out[out.index("# valve-control tune") :], encoding="utf-8")
    assert files.load("printed.yaml")["controller"]["controller"] == "pid"


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        (["--max-chatter", "1e-6"], "pid: no set within c_u 1e-06: the least is"),
        (["--overshoot", "0"], "above 0 %"),
    ],
)
def test_a_wish_that_no_set_keeps_is_no_wall(run, tmp_path, commands, wish, words):
    """The nearest is accepted, with a sentence, and the limit is counted in the table."""
    few = [*SMALL, "--budget", "24", *wish]
    files_of = ["--output", "t.yaml", "--json", "j.json"]
    status, out, err = run("tune", "--controller", "pid", *commands, *few, *files_of)
    law = json.loads((tmp_path / "j.json").read_text(encoding="utf-8"))["laws"]["pid"]
    assert status == 0 and law["accepted"] and (tmp_path / "t.yaml").is_file(), err
    assert words in err and any(words.removeprefix("pid: ") in note for note in law["notes"])
    name = "chatter" if "--max-chatter" in wish else "overshoot"
    row = next(row for row in law["limits"] if row["limit"] == name)
    assert row["missed"] > 0 and row["best"] >= row["wanted"] and f"\n{name}" in out and "inf ms" not in out


@pytest.mark.parametrize(
    ("seed", "law"), [*zip(range(5100, 5104), ("dcarc", "arc", "oarc", "pid"), strict=True)]
)
def test_a_random_valve_always_has_a_result(run, tmp_path, seed, law):
    """Of model (3) with friction, and with solenoids, with the default limits and hardly a search."""
    (tmp_path / "v.yaml").write_text(ros_file.as_yaml({"/**/valve_simulator": invented.drawn(seed)}, []))
    few = ["--valves", "2", "--unseen", "2", "--budget", "6", "--duration", "2", "--json", "-"]
    status, out, err = run("tune", "--controller", law, "--params-file", "v.yaml", *few)
    assert status in (0, 1), err
    found = json.loads(out)["laws"][law]
    assert found["chosen"] and found["front"] and {row["limit"] for row in found["limits"]} >= {"gain margin"}
    assert found["accepted"] == (not found["reasons"])
    overshot = found["verified"]["overshoot"]
    assert (overshot is not None and overshot <= 0.06) or found["reasons"] or found["notes"]


def test_friction_fixed_at_0_is_noted(run, commands):
    quick = ["--controller", "pid", "--set", "pid.form=plain", *commands, *SMALL, "--budget", "24"]
    fixed = [*quick, "--fix", "friction.coulomb", "--json", "-"]
    assert "friction.coulomb is fixed at 0 V" in run("tune", *fixed)[2]
    assert "is fixed at 0 V" not in run("tune", *fixed, "--set", "friction.coulomb=0.2")[2]


@pytest.mark.parametrize(
    "options, sentence",
    [
        (["--controller", "open_loop"], "open_loop has no gains to choose; there is nothing to tune"),
        (["--controller", "pdi"], "there is no law 'pdi'; there are arc, oarc, dcarc"),
        (["--pause", "0.1"], "--pause: 0.1 is no number from 0 to 0.05"),
        (["--set", "friction.coulomb=1.0"], "tune varies friction.coulomb from 0 to 2 V"),
        (["--command", "high.csv"], "high.csv goes to 9.5 V, for which the valve needs"),
        (["--command", "still.csv"], "the command still.csv does not move; there is nothing to tune on"),
        (["--command", "short.csv"], "short.csv lasts 0.01 s; to tune on it, it must last at least 1 s"),
        (["--preview", "--command-drift", "50"], "tune --preview takes no --command-drift"),
        (
            ["--fix", "speed", "--fix", "friction.coulomb", "--fix", "lvdt.noise"],
            "every quantity of the box is fixed; there is no spread to tune for",
        ),
    ],
)
def test_bad_input_is_one_sentence(run, tmp_path, commands, options, sentence):
    np.savetxt(tmp_path / "high.csv", np.linspace(0.0, 9.5, 1200))
    np.savetxt(tmp_path / "still.csv", np.ones(1200))
    np.savetxt(tmp_path / "short.csv", np.arange(10.0))
    few = ["--budget", "24"] if "--budget" not in options else []
    plain = ["--controller", "pid", "--set", "pid.form=plain"]
    status, out, err = run("tune", *plain, *commands, *SMALL, *few, "--output", "t.yaml", *options)
    told = sentences(err)
    assert status == 2 and out == "" and len(told) == 1 and sentence in told[0], err
    assert not (tmp_path / "t.yaml").exists()
