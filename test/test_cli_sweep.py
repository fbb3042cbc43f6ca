# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bad command lines by the hundred: one sentence, a status not 0, no traceback, nothing left behind."""

import sys
from pathlib import Path

import numpy as np
import pytest
from said import sentences

from valve_control.cli import main

sys.path.insert(0, str(Path(__file__).parent / "recordings"))
from made import Run, write

SIMULATED = ("simulate", "compare", "identify", "study", "tune")
BAGS = ("analyze {bag}", "replay {bag}", "replay {bag} --mode what-if", "compare {bag} {bag}")
OUTPUTS = {
    "simulate": "json figure csv npz",
    "compare": "json figure",
    "identify": "json figure csv output",
    "study --replay 1": "output",
    "tune": "json output",
    "analyze {bag}": "json csv html",
    "replay {bag}": "json csv html",
    "compare {bag} {bag}": "json html",
    "bag recover {bag}": "json",
}
NOWHERE = ("missing/folder/x{s}", "folder", "file.txt/x{s}", "folder/", "", "a" * 300 + "{s}", "loop{s}/x{s}")
NUMBERS = {
    "simulate": "sample-period duration",
    "identify": "sample-period duration settle",
    "study": "sample-period duration limit",
    "tune": "max-chatter gain-margin phase-margin delay-margin peak saturation",
}
ENDLESS = ("limit", "max-chatter")  # which may be as large as one likes
COUNTS = {
    "simulate": "seed",
    "identify": "seed order zeros",
    "study": "valves study-seed threads replay",
    "tune": "valves unseen budget threads",
}
ENDINGS = {"figure": "png", "json": "json", "html": "html", "csv": "csv", "npz": "npz", "output": "yaml"}
FILES = ("missing", "folder", "bad.yaml", "empty.yaml", "binary.yaml", "list.yaml", "words.csv", "/dev/zero")
ARRAYS = ("missing.csv", "folder", "words.csv", "empty.csv", "nan.csv", "plane.npy", "/dev/zero", "")
SETTINGS = ("x", "=", "x=1", "lvdt.noise", "lvdt.noise=", "lvdt.noise=nan", "lvdt.noise=-1", "lvdt.noise=[1")
SETTINGS += ("numerator=[1]x", "numerator=[.nan]", "seed=1.5", "valve=steam")
MAPS = ("spool_position", "x=/y", "spool_position=", "=", "spool_position=/a*b", "spool_position=/none.none")
STRETCHES = ("--from nan", "--to nan", "--from 9 --to 1", "--to -1", "--from x")
EXPECTATIONS = ("", "e_rms", "e_rms<", "<1", "e_rms<x", "none<1", "e_rms<nan", "e_rms=1")


def table():
    lines = []
    for command, names in OUTPUTS.items():
        for name in names.split():
            ending = f".{ENDINGS[name]}"
            lines += [[*command.split(), f"--{name}", place.format(s=ending)] for place in NOWHERE]
        lines += [[*command.split(), "--json", "same.json", f"--{n}", "same.json"] for n in names.split()[1:]]
    for command, names in NUMBERS.items():
        for name in names.split():
            values = ["nan", "inf", "-1", "fast", "", *([] if name in ENDLESS else ["1e99"])]
            lines += [[*command.split(), f"--{name}={bad}"] for bad in values]
    for command, names in COUNTS.items():
        for name in names.split():
            lines += [[*command.split(), f"--{name}={bad}"] for bad in ("-1", "1.5", "nan", "many")]
    for command in SIMULATED:
        for option, values in (("params-file", FILES), ("command", ARRAYS), ("set", SETTINGS)):
            lines += [[command, f"--{option}", bad] for bad in values]
        lines.append([command, "--no-such-option"])
    for command in BAGS:
        lines += [[*command.split(), "--map", bad] for bad in MAPS]
        lines += [command.replace("{bag}", bad).split() for bad in ("missing", "folder", "/dev/zero")]
    lines += [[*command.split(), *stretch.split()] for command in BAGS[:3] for stretch in STRETCHES]
    lines += [["analyze", "{bag}", "--expect", bad] for bad in EXPECTATIONS]
    lines += [["bag", "recover", bad] for bad in ("missing", "file.txt", "/dev/zero", "folder")]
    return [*lines, [], ["nothing"], ["bag"], ["bag", "eat"]]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
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
    made = Run()
    made.move(300)
    write(folder / "bag", made.messages)
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
