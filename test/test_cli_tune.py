# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""valve-control tune: the contract for scripts, files that go straight into simulate, refusals."""

import json
import re

import numpy as np
import pytest
from said import sentences

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
    assert limits.overshoot == 0.05 and limits._replace(overshoot=0.0) == trial.USUAL


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


def test_what_does_not_hold_is_not_written(run, tmp_path, commands, monkeypatch):
    """Valves of verification that chatter more than those of the search: the reason is said, no file."""
    from valve_control.design.tuning import verification

    monkeypatch.setattr(verification, "SLACK", 0.01)
    status, out, err = run(
        "tune", "--controller", "pid", *commands, *SMALL, "--output", "t.yaml", "--json", "-"
    )
    law = json.loads(out)["laws"]["pid"]
    assert status == 1 and not law["accepted"] and law["file"] is None
    assert "pid: not accepted, because c_u is" in err and not (tmp_path / "t.yaml").exists()


def test_a_file_from_before_is_not_taken_for_a_result(run, tmp_path, commands, monkeypatch):
    from valve_control.design.tuning import verification

    for name in ("t.yaml", "r.html", "j.json"):
        (tmp_path / name).write_text("old", encoding="utf-8")
    outputs = ["--output", "t.yaml", "--html", "r.html", "--json", "j.json"]
    few = [*SMALL, "--budget", "24"]
    status, _, err = run("tune", "--controller", "pid", *commands, *few, "--max-chatter", "1e-6", *outputs)
    assert status == 2 and "have a chatter of 1e-06 or less" in err
    for name in ("t.yaml", "r.html", "j.json"):
        assert f"{name} is from before and was not replaced" in err
        assert (tmp_path / name).read_text(encoding="utf-8") == "old"
    monkeypatch.setattr(verification, "SLACK", 0.01)
    status, _, err = run("tune", "--controller", "pid", *commands, *few, *outputs)
    assert status == 1 and "t.yaml is from before and was not replaced" in err
    assert "r.html is" not in err and "j.json is" not in err
    assert (tmp_path / "t.yaml").read_text(encoding="utf-8") == "old"
    assert json.loads((tmp_path / "j.json").read_text(encoding="utf-8"))["laws"]["pid"]["file"] is None


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
        (
            ["--max-chatter", "1e-6"],
            "pid: no gains that keep the margins have a chatter of 1e-06 or less; the least",
        ),
        (
            ["--gain-margin", "60"],
            "sets of gains can be used",
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
