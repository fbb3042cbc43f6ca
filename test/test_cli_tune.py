# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""valve-control tune: the contract for scripts, files that go straight into simulate, refusals."""

import json
import math
import re

import numpy as np
import pytest
from said import sentences

from benchmarks import invented
from valve_control.cli import command, tune
from valve_control.control.parameters import files
from valve_control.design.tuning import trial

FIXED = (
    "gain",
    "flow_force",
    "disturbance.offset",
    "friction.static_ratio",
    "drift.gain",
    "drift.stiffness",
    "lvdt.delay",
)
SMALL = [option for name in FIXED for option in ("--fix", name)]
SMALL += ["--valves", "3", "--unseen", "4", "--budget", "60", "--seed", "2", "--max-chatter", "0.6"]


def test_what_has_to_hold_is_what_commission_asks_for_too():
    """But for the overshoot, which commission leaves open, as its reference has the paper's form."""
    limits = tune._limits(command.parser().parse_args(["tune"]))
    assert limits.overshoot == trial.OVERSHOOT and limits._replace(overshoot=math.inf) == trial.USUAL


def test_none_switches_a_limit_off_and_0_means_0():
    names = (
        "gain-margin",
        "phase-margin",
        "delay-margin",
        "peak",
        "swing",
        "saturation",
        "pause",
        "overshoot",
    )
    off = tune._limits(command.parser().parse_args(["tune", *(f"--{name}=none" for name in names)]))
    assert off == trial.TuningLimits(0.0, 0.0, 0.0, math.inf, math.inf, math.inf, 0.0, math.inf)
    zero = ["tune", "--saturation", "0", "--overshoot", "0"]
    limits = tune._limits(command.parser().parse_args(zero))
    assert (limits.saturated, limits.overshoot) == (0.0, 0.0)


def test_without_a_result_there_is_no_head_of_a_table(capsys):
    tune._print({})
    assert capsys.readouterr().out == ""


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
    status, out, err = run(
        "tune",
        "--controller",
        "dcarc,pid",
        *commands,
        *SMALL,
        "--output",
        "t.yaml",
        "--html",
        "r.html",
        "--json",
        "-",
    )
    assert status == 0, err
    result = json.loads(out)
    assert list(result["laws"]) == ["dcarc", "pid"] and "beside" not in result
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
        status, out, err = run(
            "simulate", "--params-file", law["file"], commands[0], commands[1], "--json", "-"
        )
        alone = json.loads(out)
        assert status == 0 and alone["controller"] == name and alone["warning"] is None
        assert alone["true_error"]["e_rms"] < 0.1
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert page.index("<h2>Verdict</h2>") < page.index("<h2>Error against chatter</h2>")
    assert "dcarc holds: e_rms" in page and "times the error of the best PID" in page
    best = min(result["laws"], key=lambda law: result["laws"][law]["verified"]["e_rms"]["median"])
    first = f"<h2>Verdict</h2>\n<p>{best} has the least error of the 2 laws whose gains are accepted.</p>"
    assert first in page and "valve-control tune --controller dcarc,pid --command a.csv" in page
    assert page.count('"name":"chosen"') == 2
    assert lines_of(page, "worst valve") == {"#D55E00"}  # of position and voltage alike


def test_a_law_without_feedback_is_tuned_and_reported_too(run, tmp_path, commands):
    """The compensator has no loop, no period of its own, and margins without end."""
    status, out, err = run(
        "tune", "--controller", "compensator", "--alone", *commands, *SMALL, "--html", "r.html", "--json", "-"
    )
    assert status in (0, 1) and "Traceback" not in err, err
    law = json.loads(out)["laws"]["compensator"]
    assert law["margins"]["gain_db"] is None and law["verified"]["e_rms"]["median"] > 0.0
    assert "compensator: steps" in (tmp_path / "r.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("law", "valve", "own", "words"),
    [
        ("dcarc", "[1.0, 300.0, 48000.0]", [], "note: dcarc.model is that of the valve, custom"),
        ("compensator", "[1.0, 300.0, 48000.0]", [], "note: compensator.model is that of the valve, custom"),
        ("dcarc", "[1.0, 300.0, 48000.0]", ["--set", "dcarc.model=second_order"], ""),
        ("dcarc", "[1.0, 48000.0]", [], "note: dcarc.model stays fourth_order, which is another valve"),
    ],
)
def test_a_law_gets_the_model_of_the_valve_that_is_given(run, commands, law, valve, own, words):
    """Or says that it keeps another; a model that was chosen stays without a word."""
    given = ["--set", "valve=custom", "--set", "numerator=[48000.0]", "--set", f"denominator={valve}"]
    refused = [*SMALL, "--alone", "--json", "-", "--folder", ""]  # after the models are chosen
    _, _, err = run("tune", "--controller", law, *commands, *given, *own, *refused)
    assert words in err and ("dcarc.model" in err) == (law == "dcarc" and bool(words)), err


def lines_of(page, name):
    """Colours of the lines ``name`` in all figures."""
    return set(re.findall(f'"legendgroup":"{name}","line":{{"color":"(#[0-9A-F]{{6}})"', page))


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
    assert "margins --box shows where" in err
    row = next(row for row in law["limits"] if row["limit"] == "gain margin")
    assert row["missed"] == row["looked_at"] >= 24 and row["best"] < row["wanted"] == 60.0


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        (["--max-chatter", "1e-6"], "pid: no set within c_u 1e-06: the least is"),
        (
            ["--overshoot", "0"],
            "above 0 %",
        ),
    ],
)
def test_a_wish_that_no_set_keeps_is_no_wall(run, tmp_path, commands, wish, words):
    """The nearest is accepted, with a sentence, and the limit is counted in the table."""
    few = [*SMALL, "--budget", "24", "--alone", *wish]
    files_of = ["--output", "t.yaml", "--json", "j.json"]
    status, out, err = run("tune", "--controller", "pid", *commands, *few, *files_of)
    law = json.loads((tmp_path / "j.json").read_text(encoding="utf-8"))["laws"]["pid"]
    assert status == 0 and law["accepted"] and (tmp_path / "t.yaml").is_file(), err
    assert words in err and any(words.removeprefix("pid: ") in note for note in law["notes"])
    name = "chatter" if "--max-chatter" in wish else "overshoot"
    row = next(row for row in law["limits"] if row["limit"] == name)
    assert row["missed"] > 0 and row["best"] >= row["wanted"] and f"\n{name}" in out and "inf ms" not in out


def test_a_file_from_before_is_not_taken_for_a_result(run, tmp_path, commands):
    for name in ("t.yaml", "t_arc.yaml", "r.html", "j.json"):
        (tmp_path / name).write_text("old", encoding="utf-8")
    outputs = ["--output", "t.yaml", "--html", "r.html", "--json", "j.json"]
    few = [*SMALL, "--budget", "24", *outputs]
    status, _, err = run("tune", "--controller", "pid", *commands, *few, "--scenario", "sine")
    assert status == 2 and "contradict each other" in err
    for name in ("t.yaml", "t_arc.yaml", "r.html", "j.json"):
        assert f"{name} is from before and was not replaced" in err
        assert (tmp_path / name).read_text(encoding="utf-8") == "old"
    status, _, err = run("tune", "--controller", "pid", *commands, *few, *NEVER)
    assert status == 1 and "t.yaml is from before and was not replaced" in err and "t_arc.yaml is" in err
    assert "r.html is" not in err and "j.json is" not in err
    assert (tmp_path / "t.yaml").read_text(encoding="utf-8") == "old"
    assert json.loads((tmp_path / "j.json").read_text(encoding="utf-8"))["laws"]["pid"]["file"] is None


@pytest.mark.parametrize(
    ("seed", "law"), [*zip(range(5100, 5106), ("dcarc", "arc", "oarc", "pid", "dcarc", "pid"), strict=True)]
)
def test_a_random_valve_always_has_a_result(run, tmp_path, seed, law):
    """Of model (3) with friction, and with solenoids, with the default limits and hardly a search."""
    (tmp_path / "v.yaml").write_text(files.as_yaml({"/**/valve_simulator": invented.drawn(seed)}, []))
    few = ["--alone", "--valves", "2", "--unseen", "2", "--budget", "6", "--duration", "2", "--json", "-"]
    status, out, err = run("tune", "--controller", law, "--params-file", "v.yaml", *few)
    assert status in (0, 1), err
    found = json.loads(out)["laws"][law]
    assert found["chosen"] and found["front"] and {row["limit"] for row in found["limits"]} >= {"gain margin"}
    assert found["accepted"] == (not found["reasons"])
    overshot = found["verified"]["overshoot"]
    assert (overshot is not None and overshot <= 0.06) or found["reasons"] or found["notes"]


@pytest.mark.parametrize(
    "options, sentence",
    [
        (["--controller", "open_loop"], "open_loop has no gains to choose; there is nothing to tune"),
        (["--controller", "pdi"], "there is no law 'pdi'; there are arc, oarc, dcarc"),
        (["--max-error", "0.01"], "--max-chatter and --max-error contradict each other; give one of them"),
        (["--max-chatter", "nan"], "--max-chatter is nan; it must be above 0, and finite"),
        (["--pause", "0.1"], "--pause is 0.1; it must lie between 0 and 0.05"),
        (["--phase-margin", "-1"], "--phase-margin is -1; it must lie between 0 and 120"),
        (["--budget", "0"], "--budget is 0; it must be at least 1"),
        (["--seed", "-1"], "--seed is -1; it must lie between 0 and 2000000000"),
        (["--seed", "2147000000"], "--seed is 2147000000; it must lie between 0 and 2000000000"),
        (["--valves", "0"], "--valves is 0; it must lie between 1 and 100000"),
        (["--set", "friction.coulomb=1.0"], "tune varies friction.coulomb from 0 to 2 V"),
        (
            ["--scenario", "sine"],
            "--command a.csv and --scenario sine contradict each other; give one of them",
        ),
        (["--command", "high.csv"], "high.csv goes to 9.5 V, for which the valve needs"),
        (["--command", "still.csv"], "the command still.csv does not move; there is nothing to tune on"),
        (
            ["--command", "short.csv"],
            "the command short.csv lasts 0.01 s; to tune on it, it must last at least 1 s",
        ),
        (["--output", "a.csv"], "a.csv"),
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
    status, out, err = run(
        "tune",
        "--controller",
        "pid",
        "--set",
        "pid.form=plain",
        *commands,
        *SMALL,
        *few,
        "--output",
        "t.yaml",
        *options,
    )
    told = sentences(err)
    assert status == 2 and out == "" and len(told) == 1 and sentence in told[0], err
    assert not (tmp_path / "t.yaml").exists()
