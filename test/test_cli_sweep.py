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
    "study --replay 1": "json figure output",
    "study": "json figure",
    "tune": "json output html",
    "compensator": "json figure output",
    "analyze {bag}": "json csv html",
    "replay {bag}": "json csv html",
    "compare {bag} {bag}": "json figure html",
    "bag recover {bag}": "json",
}
NOWHERE = ("missing/folder/x{s}", "folder", "file.txt/x{s}", "folder/", "", "a" * 300 + "{s}", "loop{s}/x{s}")
NUMBERS = {
    "simulate": "sample-period duration",
    "compare": "sample-period duration",
    "identify": "sample-period duration settle",
    "study": "sample-period duration limit",
    "tune": "max-chatter max-error gain-margin phase-margin delay-margin peak saturation",
    "compensator": "bandwidth sample-period u-max amplitude",
}
COUNTS = {
    "simulate": "seed",
    "compare": "seed",
    "identify": "seed order zeros",
    "study": "valves study-seed threads replay",
    "tune": "valves unseen budget threads",
    "compensator": "order",
}
ENDINGS = {
    "figure": ".png",
    "json": ".json",
    "html": ".html",
    "csv": ".csv",
    "npz": ".npz",
    "output": ".yaml",
}


def table():
    lines = []
    for command, names in OUTPUTS.items():
        for name in names.split():
            for place in NOWHERE:
                lines.append([*command.split(), f"--{name}", place.format(s=ENDINGS[name])])
        lines += [[*command.split(), "--json", "same.json", f"--{n}", "same.json"] for n in names.split()[1:]]
    for command, names in NUMBERS.items():
        for name in names.split():
            for bad in ("nan", "inf", "-1", "1e99", "fast", ""):
                if bad != "1e99" or name not in ("limit", "amplitude", "max-chatter", "max-error", "peak"):
                    lines.append([*command.split(), f"--{name}={bad}"])
    for command, names in COUNTS.items():
        for name in names.split():
            lines += [[*command.split(), f"--{name}={bad}"] for bad in ("-1", "1.5", "nan", "many")]
    for command in SIMULATED:
        for bad in (
            "missing.yaml",
            "folder",
            "bad.yaml",
            "empty.yaml",
            "binary.yaml",
            "list.yaml",
            "/dev/zero",
        ):
            lines.append([*command.split(), "--params-file", bad])
        for bad in (
            "missing.csv",
            "folder",
            "words.csv",
            "empty.csv",
            "nan.csv",
            "plane.npy",
            "/dev/zero",
            "",
        ):
            lines.append([*command.split(), "--command", bad])
        for bad in (
            "x",
            "=",
            "x=1",
            "lvdt.noise",
            "lvdt.noise=",
            "lvdt.noise=nan",
            "lvdt.noise=-1",
            "numerator=[1]x",
            "numerator=[.nan]",
            "seed=1.5",
            "valve=steam",
            "lvdt.noise=[1",
        ):
            lines.append([*command.split(), "--set", bad])
        lines.append([*command.split(), "--no-such-option"])
    for command in BAGS:
        for bad in (
            "spool_position",
            "x=/y",
            "spool_position=",
            "spool_position=/none",
            "=",
            "spool_position=/a*b",
            "spool_position=/spool_position.none",
            "spool_position=/spool_position*nan",
            "spool_position=/spool_position.data[7]",
            "spool_position=/spool_position.data[x",
        ):
            lines.append([*command.split(), "--map", bad])
        for bad in ("missing", "folder", "file.txt", "/dev/zero", "/dev/null", "binary.yaml"):
            lines.append([word if word != "{bag}" else bad for word in command.split()])
    for command in BAGS[:3]:
        for bad in (
            ["--from", "nan"],
            ["--to", "nan"],
            ["--from", "9", "--to", "1"],
            ["--to", "-1"],
            ["--from", "x"],
        ):
            lines.append([*command.split(), *bad])
    for bad in ("", "e_rms", "e_rms<", "<1", "e_rms<x", "none<1", "e_rms<nan", "e_rms=1"):
        lines.append(["analyze", "{bag}", "--expect", bad])
    for bad in (
        "missing.csv",
        "folder",
        "words.csv",
        "empty.yaml",
        "bad.yaml",
        "list.yaml",
        "binary.yaml",
        "/dev/zero",
    ):
        lines.append(["compensator", "--from", bad])
    for bad in ("missing", "file.txt", "/dev/zero", "folder"):
        lines.append(["bag", "recover", bad])
    for bad in (["nan"], ["0"], ["inf"], ["0", "0"], ["1e-300"], ["-1"]):
        lines.append(["compensator", "--numerator", *bad, "--denominator", "1", "58", "1650"])
        lines.append(["compensator", "--numerator", "1500", "--denominator", "1", *bad])
    return lines + [
        [],
        ["nothing"],
        ["bag"],
        ["bag", "eat"],
        ["replay", "{bag}", "--mode", "live", "--rate", "0"],
    ]


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
    for ending in set(ENDINGS.values()):
        (folder / f"loop{ending}").symlink_to(f"loop{ending}")
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
