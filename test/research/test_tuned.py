# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The comparison of tuned laws as a user runs it, and the former commands of research."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from said import sentences

from research.tuned import main

ROOT = Path(__file__).parents[2]


@pytest.fixture
def tuned(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        try:
            status = main(list(arguments))
        except SystemExit as ended:
            status = ended.code
        return status, *capsys.readouterr()

    return call


def test_tuned_laws_beside_the_oracle(tuned, tmp_path):
    status, out, err = tuned("--valves", "2", "--json", "t.json", "--figure", "t.png")
    assert status == 0, err
    assert "medians over 2 valves of the narrow box" in out and "wrote t.png" in out
    result = json.loads((tmp_path / "t.json").read_text())
    assert result["valves"] == 2 and result["laws"]["pid_plain"]["preview_s"] > 0.0
    for mode in ("with preview", "command alone"):
        assert {"pid_plain", "pid_reference", "oarc", "dcarc", "oracle"} == result[mode].keys()
        for told in result[mode].values():
            assert len(told["median"]) == 5 and told["c_u"] > 0.0
    assert (tmp_path / "t.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--valves", "0"], "--valves is 0; it must lie between 1 and 100000"),
        (["--seed", "-1"], "--seed is -1; it must be 0 or more"),
        (["--limit", "0.123"], "no gains are tuned for the narrow box at c_u <= 0.123"),
        (["--limit", "nan"], "--limit is nan; it must be above 0, and finite"),
        (["--limit", "-1"], "--limit is -1; it must be above 0, and finite"),
        (["--gains", "nowhere"], "nowhere has none"),
        (["--box", "huge"], "invalid choice"),
        (["--figure", "t.pdf"], ".png or .svg"),
    ],
)
def test_bad_input_is_one_sentence(tuned, tmp_path, arguments, words):
    status, out, err = tuned(*arguments)
    assert status == 2 and out == ""
    assert len(sentences(err)) == 1 and words in err, err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "target"),
    [
        ("theorems --valves 3 --json -", "theorems"),
        ("paper --offline", "paper"),
        ("axes --axes 2", "axis"),
        ("axis --delta --json d.json", "delta"),
        ("compare --tuned --valves 2", "tuned"),
    ],
)
def test_a_former_command_names_the_present_one(run, tmp_path, arguments, target):
    status, out, err = run(*arguments.split())
    assert status == 2 and out == "" and err.count("\n") == 1
    assert err.endswith(f"in a checkout of valve_control: make {target}\n")
    assert f"\n{target}: " in (ROOT / "Makefile").read_text()


def test_ctrl_c_ends_a_study_quietly(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-m", "research.theorems", "--processes", "1", "--json", str(tmp_path / "t.json")],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    ) as child:  # fmt: skip
        begun = child.stderr.read(12)
        child.send_signal(signal.SIGINT)
        _, err = child.communicate(timeout=60)
    assert begun.strip() == "bound on V2" and child.returncode == 130 and "Traceback" not in err, err
    assert list(tmp_path.iterdir()) == []
