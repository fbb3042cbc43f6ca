# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""`compare` without a bag: which file holds for which law, and when the paper's numbers stand beside it."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXPERIMENT = ROOT / "config" / "d3fxe_experiment.yaml"
TUNED = [ROOT / "config" / "tuned" / f"d3fxe_experiment_{law}.yaml" for law in ("dcarc", "pid", "arc")]


@pytest.mark.parametrize("order", [TUNED, TUNED[::-1], TUNED[:1]])
def test_compare_runs_each_law_with_its_own_file(order, run):
    """However the files are ordered, a law has the errors that `simulate` gives with its file alone."""
    files = [word for path in order for word in ("--params-file", path)]
    usual = ("--params-file", EXPERIMENT, "--duration", "1.0", "--json", "-")
    status, out, _ = run("compare", *usual, *files)
    assert status == 0
    compared = {r["controller"]: r["indices"] for r in json.loads(out)["runs"]}
    for path in TUNED:
        law = path.stem.rsplit("_", 1)[1]
        own = ("--params-file", path) if path in order else ("--controller", law)
        assert compared[law] == json.loads(run("simulate", *usual, *own)[1])["indices"], law


@pytest.mark.parametrize(
    "other",
    [
        ["--valve", "custom", "--set", "numerator=[12000.0]", "--set", "denominator=[1.0, 150.0, 12000.0]"],
        ["--scenario", "sine"],
    ],
)
def test_the_papers_rows_stand_beside_its_valve_and_motion_alone(other, run, tmp_path):
    status, out, _ = run("compare", "--duration", "1.0", "--json", "c.json", *other)
    assert status == 0 and "paper" not in out
    assert json.loads((tmp_path / "c.json").read_text())["paper"] == {}
