# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""`valve-control calibrate` as a user runs it."""

import json

import pytest
from said import sentences

TINY = ("--set", "duration=2.0", "--set", "cycle=2.0", "--set", "start=0.0", "--noise-seeds", "2")
FIXED = ("offset", "cycle", "amplitude", "disturbance.offset", "lvdt.delay", "flow_force")


def test_calibrated_file_gives_what_was_promised(run, tmp_path):
    """Its output, taken by `compare`, has the indices of the fit."""
    (tmp_path / "t.csv").write_text("controller,e_rms,u_rms\npid,0.05,2.0\narc,0.03,2.1\n")
    fixed = [word for name in FIXED for word in ("--fix", name)]
    done = run(
        "calibrate", "t.csv", *TINY, *fixed, "--evaluations", 60, "--population", 8, "--output", "v.yaml",
        "--json", "v.json", "--trials", "--processes", 2,
    )  # fmt: skip
    assert done.status == 0, done.err
    assert "wrote v.yaml" in done.out and "wrote v.json" in done.out
    result = json.loads((tmp_path / "v.json").read_text())
    assert result["noise_seeds"] == [1, 2] and result["evaluations"] >= 60
    assert not any(name in result["values"] for name in FIXED)
    assert "oarc.z2_weight" not in result["values"]
    again = run("compare", "--params-file", "v.yaml", "--json", "-")
    runs = {r["controller"]: r["indices"] for r in json.loads(again.out)["runs"]}
    for name, e_rms, u_rms in (("pid", 0.05, 2.0), ("arc", 0.03, 2.1)):
        ratios = result["first_seed"]["ratios"][name]
        assert runs[name]["e_rms"] / e_rms == pytest.approx(ratios["e_rms"], rel=1e-12)
        assert runs[name]["u_rms"] / u_rms == pytest.approx(ratios["u_rms"], rel=1e-12)
        assert ratios["e_M"] is None
    assert [t["name"] for t in result["trials"]][:2] == ["as calibrated", "noise seed 2"]
    assert result["trials"][0]["indices"]["pid"]["u_rms"] == runs["pid"]["u_rms"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["none.csv"], "cannot be read"),
        (["paper", "--fix", "mass"], "no such quantity"),
        (["paper", "--evaluations", "0"], "between 1 and"),
        (["paper", "--search-seed", "-1"], "between 0 and"),
        (["paper", "--step", "7"], "between 0.001 and 1"),
        (["paper", "--output", "no/where.yaml"], "no folder"),
        (["paper", "--output", "a", "--json", "a"], "two outputs"),
        (["paper", "--json", "-", "--output", "-"], "only --json takes -"),
    ],
)
def test_bad_input_is_one_sentence(run, tmp_path, arguments, said):
    done = run("calibrate", *arguments)
    assert done.status == 2 and said in done.err and len(sentences(done.err)) == 1
    assert list(tmp_path.iterdir()) == []


def test_ranges_are_listed(run):
    done = run("calibrate", "paper", "--ranges", "--set", "scenario=sine")
    assert done.status == 0 and "friction.presliding" in done.out
    assert "\ncycle" not in done.out


def test_ranges_as_json_and_counts_within_bounds(run, tmp_path):
    """--json was without effect beside --ranges; a thousand million seeds were an endless run."""
    status, out, _ = run("calibrate", "paper", "--ranges", "--fix", "gain_scale", "--json", "-")
    names = [one["name"] for one in json.loads(out)["ranges"]]
    assert status == 0 and "flow_force" in names and "gain_scale" not in names
    for option in ("--noise-seeds", "--population"):
        status, out, err = run("calibrate", "paper", option, "1000000000")
        assert (status, out) == (2, "") and f"{option} is 1000000000; it must lie between" in err
    (tmp_path / "t.csv").write_text("controller,e_rms,e_rms\npid,0.05,0.06\n")
    status, _, err = run("calibrate", "t.csv", "--ranges")
    assert status == 2 and "two columns of one name" in err
