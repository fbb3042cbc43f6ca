# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bad command lines, some by the hundred: one sentence, a status not 0, no traceback, nothing left behind."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from said import sentences

from valve_control.cli import main

sys.path.insert(0, str(Path(__file__).parent / "recordings"))
from made import Run, write

QUICK = ["--set", "steps=12", "--set", "cycles=4"]
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    made = Run()
    made.move(300)
    for name in ("arc", "pid"):
        write(folder / name, made.messages)
    return folder


def refused(called, *words):
    status, out, err = called
    assert status == 2 and out == "", out + err
    assert len(sentences(err)) == 1, err
    for word in words:
        assert word in err, err


def test_parameters_of_nodes_that_do_not_exist(run, tmp_path):
    other = "camera:\n  ros__parameters: {rate: 30.0}\n"
    (tmp_path / "typing.yaml").write_text("controler:\n  ros__parameters: {arc: {k1: 99.0}}\n")
    (tmp_path / "other.yaml").write_text(other)
    (tmp_path / "both.yaml").write_text(other + "controller:\n  ros__parameters: {arc: {k1: 99.0}}\n")
    (tmp_path / "twice.yaml").write_text("controller:\n  ros__parameters: {arc.k1: 99.0, arc: {k1: 9.0}}\n")
    (tmp_path / "one.csv").write_text("0.5\n")
    (tmp_path / "comma.csv").write_text("0,5\n1,5\n")
    refused(run("simulate", "--params-file", "twice.yaml"), "twice.yaml gives arc.k1 twice")
    refused(run("simulate", "--command", "comma.csv"), "comma.csv", "with decimal points", "(2, 2)")
    refused(run("simulate", "--command", "one.csv"), "one.csv must hold one column of two or more")
    refused(run("simulate", "--params-file", "typing.yaml"), "controler", "alone")
    refused(run("simulate", "--params-file", "other.yaml"), "camera", "alone")
    refused(run("identify", "--params-file", "other.yaml"), "camera", "alone")
    for path, words in (
        ("both.yaml", ["camera", "left out"]),
        (ROOT / "config/axis/bench.yaml", ["/**/axis_simulator", "left out"]),
    ):
        status, _, err = run("simulate", "--duration", "0.1", "--params-file", path)
        assert status == 0 and f"note: {path}" in err and all(word in err for word in words), err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "--command", "c.csv", "--scenario", "sine"], ["--command takes no --scenario"]),
        (["simulate", "--set", "valve=custom", "--set", "numerator=[-1502.0]"], ["must be positive"]),
        (["export", "--output", "e", "--set", "dcarc.denominator=[1.0, 2.0]"], ["dcarc.model=custom"]),
        (["study", "--replay", "1", "--output", "v.yaml", "--figure", "f.png"], ["--figure", "--replay"]),
        (["identify", "--set", "valve=second_order", "--order", "4", *QUICK], ["not support", "--order 2"]),
        (["simulate", "--command-period", "0.01", "--command-jitter", "0.02"], ["jitter is 0.02 s"]),
        (["identify", "--data-sheet", "damping=1,2"], ["'1,2'", "write 1.2, not 1,2"]),
        (["study", "--threads", "10000"], ["--threads: 10000 is no whole number from 1 to"]),
        (["tune", "--controller", "pid", "--set", "pid.kp=3"], ["the search chooses"]),
        (["simulate", "--scenario", "sine", "--set", "frequency=500.0"], ["500 Hz", "Nyquist"]),
        (["study", "--scenario", "sweep", "--set", "end_frequency=300.0"], ["300 Hz", "Nyquist"]),
        (["simulate", "--valve", "custom", "--set", "denominator=[1.0, -58.0, 1650.0]"], ["pole at"]),
        (["simulate", "--set", "bag=monday"], ["bag", "running nodes alone"]),
        (["export", "--controller", "pid", "--output", "e.fmu"], ["e.fmu", "--fmu 2 or --fmu 3"]),
        (["export", "--output", "e/", "--json", "e"], ["e is given for two outputs"]),
        (["export", "--output", "e", "--set", "friction.coulomb=1"], ["a law alone", "friction.coulomb"]),
        (["margins", "--set", "amplitude=1"], ["at rest", "amplitude"]),
        (["compare", "--set", "controller=pid"], ["--set controller", "--controller LAW"]),
        (["commission", "--undo", "--folder", "nosuch"], ["no commissioning in nosuch"]),
        (["simulate", "--duraton", "3"], ["valve-control simulate", "--duraton 3"]),
        (["parameters", "zzz"], ["no parameter has 'zzz' in its name"]),
        (["simulate", "--duration", "1e6"], ["samples takes", "GB of memory", "shorten the duration"]),
        (["simulate", "--duration", "0.1", "--figure", "x.xyz"], ["x.xyz", ".png or .svg"]),
        (["analyze", "a" * 300], ["cannot be read", "name too long"]),
        (["replay", "/dev/null"], ["/dev/null", "neither a file nor a folder"]),
    ],
)
def test_contradictions(run, tmp_path, arguments, words):
    (tmp_path / "c.csv").write_text("0.0\n0.5\n1.0\n")
    refused(run(*arguments), *words)
    assert [p.name for p in tmp_path.iterdir()] == ["c.csv"]


def test_an_output_does_not_take_the_place_of_an_input(run, bags, tmp_path, config):
    (tmp_path / "c.csv").write_text("0.0\n0.5\n1.0\n")
    (tmp_path / "p.yaml").write_text((config / "arc.yaml").read_text())
    os.link(tmp_path / "c.csv", tmp_path / "same.csv")
    os.symlink(tmp_path / "p.yaml", tmp_path / "link.yaml")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    inside = sorted(p.name for p in (bags / "arc").iterdir())
    for arguments in (
        ["simulate", "--command", "c.csv", "--csv", "same.csv"],
        ["simulate", "--params-file", "link.yaml", "--json", "p.yaml"],
        ["identify", "--params-file", "p.yaml", "--output", "link.yaml"],
        ["analyze", bags / "arc", "--csv", bags / "arc" / "metadata.yaml"],
        ["replay", bags / "arc", "--json", bags / "arc" / "r.json"],
        ["simulate", "--command", bags / "arc", "--csv", bags / "arc" / "x.csv"],
    ):
        refused(run(*arguments), "input")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert sorted(p.name for p in (bags / "arc").iterdir()) == inside


def test_read_only_outputs_stay(run, bags, tmp_path):
    """They were replaced, since that takes no more than a folder that can be written."""
    names = ("x.json", "x.png", "x.yaml", "x.html")
    for name in names:
        (tmp_path / name).write_text("kept")
        (tmp_path / name).chmod(0o444)
    for arguments in (
        ["simulate", "--duration", "0.1", "--figure", "x.png"],
        ["identify", "--output", "x.yaml"],
        ["analyze", bags / "arc", "--html", "x.html"],
        ["bag", "recover", bags / "arc", "--json", "x.json"],
    ):
        refused(run(*arguments), arguments[-1], "read-only")
    assert all((tmp_path / name).read_text() == "kept" for name in names)


def shell(text, **environment):
    """A command line in bash, in which valve-control is the command."""
    command = f'valve-control() {{ "{sys.executable}" -m valve_control.cli "$@"; }}; {text}'
    return subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False,
        env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "status"),
    [
        ("valve-control simulate --duration 0.1 >&-", 0),
        ("valve-control simulate --duration 0.1 >&- 2>&-", 0),
        ("valve-control parameters arc >&- <&-", 0),
        ("valve-control simulate --duration 0.1 --json - >&-", 2),
        ("valve-control simulate --nothing >&- 2>&-", 2),
    ],
)
def test_closed_streams_are_no_traceback(text, status):
    done = shell(text)
    assert done.returncode == status and "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == (1 if status and "2>&-" not in text else 0)


def test_an_output_that_cannot_take_it_says_so(tmp_path):
    """Standard output or a file on a full disk: one sentence, status 1, also from the end of the process."""
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "valve_control.cli", "parameters"],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.splitlines() == ["valve-control: output cannot be written: No space left on device"]
    done = subprocess.run(
        [sys.executable, "-m", "valve_control.cli", "simulate", "--duration", "0.1", "--json", "/dev/full"],
        capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 1 and "/dev/full cannot be written" in done.stderr
    assert "Traceback" not in done.stderr and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "low", "high"),
    [
        (["--scenario", "sine"], 0.6, 3.1),
        (["--scenario", "step"], 0.15, 0.15),
        (["--limit", "0.3"], 0.3, 0.3),
    ],
)
def test_the_limit_of_a_study_fits_the_motion(run, options, low, high):
    """A sine always has a following error; most of its loops are stable all the same."""
    status, out, err = run("study", *options, "--valves", "64", "--folder", "kept", "--json", "-")
    assert status == 0, err
    result = json.loads(out)
    assert low <= result["limit"] <= high
    assert result["unstable"] < 0.2


SIMULATED = ("simulate", "compare", "identify", "study", "tune")
BAGS = ("analyze {bag}", "replay {bag}", "simulate --command {bag}")
OUTPUTS = {
    "simulate": "json figure csv npz",
    "compare": "json figure",
    "identify": "json figure csv output",
    "study --replay 1": "output",
    "tune": "json output",
    "analyze {bag}": "json csv html",
    "replay {bag}": "json csv html",
    "bag recover {bag}": "json",
}
NOWHERE = ("missing/folder/x{s}", "folder", "file.txt/x{s}", "folder/", "", "a" * 300 + "{s}", "loop{s}/x{s}")
NUMBERS = {
    "simulate": "sample-period duration",
    "identify": "sample-period duration settle",
    "study": "sample-period duration limit",
    "tune": "max-chatter gain-margin phase-margin delay-margin peak saturation",
}
COUNTS = {
    "simulate": "seed",
    "identify": "seed order zeros",
    "study": "valves study-seed threads replay",
    "tune": "valves unseen budget threads",
}
ENDINGS = {"figure": "png", "json": "json", "html": "html", "csv": "csv", "npz": "npz", "output": "yaml"}
FILES = ("missing", "folder", "bad.yaml", "empty.yaml", "binary.yaml", "list.yaml", "words.csv")
ARRAYS = ("missing.csv", "folder", "words.csv", "empty.csv", "nan.csv", "plane.npy", "")
SETTINGS = ("x", "=", "x=1", "lvdt.noise", "lvdt.noise=", "lvdt.noise=nan", "lvdt.noise=-1", "lvdt.noise=[1")
SETTINGS += ("numerator=[1]x", "numerator=[.nan]", "seed=1.5", "valve=steam")
MAPS = ("spool_position", "x=/y", "spool_position=", "=", "spool_position=/a*b", "spool_position=/none.none")
STRETCHES = ("--from nan", "--to nan", "--from 9 --to 1", "--to -1", "--from x")


def table():
    lines = []
    for command, names in OUTPUTS.items():
        for name in names.split():
            ending = f".{ENDINGS[name]}"
            lines += [[*command.split(), f"--{name}", place.format(s=ending)] for place in NOWHERE]
        lines += [[*command.split(), "--json", "same.json", f"--{n}", "same.json"] for n in names.split()[1:]]
    for command, names in NUMBERS.items():
        for name in names.split():
            lines += [
                [*command.split(), f"--{name}={bad}"] for bad in ("nan", "inf", "-1", "fast", "", "1e99")
            ]
    for command, names in COUNTS.items():
        for name in names.split():
            lines += [[*command.split(), f"--{name}={bad}"] for bad in ("-1", "1.5", "nan", "many")]
    for command in SIMULATED:
        for option, values in (("params-file", FILES), ("command", ARRAYS), ("set", SETTINGS)):
            lines += [[command, f"--{option}", bad] for bad in values]
        lines.append([command, "--no-such-option"])
    for command in BAGS:
        lines += [[*command.split(), "--map", bad] for bad in MAPS]
        lines += [command.replace("{bag}", bad).split() for bad in ("missing", "folder", "/dev/null")]
    lines += [[*command.split(), *stretch.split()] for command in BAGS for stretch in STRETCHES]
    lines += [["bag", "recover", bad] for bad in ("missing", "file.txt", "/dev/null", "folder")]
    return [*lines, [], ["nothing"], ["bag"], ["bag", "eat"]]


@pytest.fixture(scope="module")
def place(tmp_path_factory, bags):
    folder = tmp_path_factory.mktemp("place")
    (folder / "folder").mkdir()
    (folder / "file.txt").write_text("no bag, no table\n")
    (folder / "bad.yaml").write_text("a: [1, 2\n")
    (folder / "empty.yaml").write_text("")
    (folder / "list.yaml").write_text("- 1\n- 2\n")
    (folder / "binary.yaml").write_bytes(bytes(range(256)))
    (folder / "words.csv").write_text("one\ntwo\n")
    (folder / "empty.csv").write_text("")
    (folder / "nan.csv").write_text("1.0\nnan\n")
    np.save(folder / "plane.npy", np.zeros((3, 3)))
    for ending in ENDINGS.values():
        (folder / f"loop.{ending}").symlink_to(f"loop.{ending}")
    shutil.copytree(bags / "arc", folder / "bag")
    return folder


def everything(folder):
    return {p: p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


def check(place, capsys, lines):
    before = everything(place)
    wrong = []
    for line in lines:
        words = [word.replace("{bag}", "bag") for word in line]
        try:
            status = main(words)
        except SystemExit as left:
            status = left.code
        except Exception as error:  # what a user would see as a traceback
            status = f"{type(error).__name__}: {error}"
        out, err = capsys.readouterr()
        told = [row for row in sentences(err) if row.strip() and not row.startswith("note: ")]
        if status not in (1, 2) or len(told) != 1 or "Traceback" in err or out:
            wrong.append((" ".join(words)[:120], status, err[-300:], out[:100]))
        now = everything(place)
        if now != before:
            wrong.append((" ".join(words)[:120], "left behind", sorted(map(str, now.keys() - before.keys()))))
            before = now
    assert not wrong, "\n".join(map(str, wrong))


def test_every_twentieth_bad_command_line(place, capsys, monkeypatch):
    monkeypatch.chdir(place)
    check(place, capsys, table()[::20])


@pytest.mark.campaign
def test_all_bad_command_lines(place, capsys, monkeypatch):
    monkeypatch.chdir(place)
    assert len(table()) >= 200
    check(place, capsys, table())
