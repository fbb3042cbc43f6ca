# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""README and docs: their command blocks run, their reference is complete, the command's help is by task."""

import importlib.util
import os
import re
import shlex
import subprocess
import sys
import textwrap
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

import pytest

from valve_control.axis.tables import ROS_NODES
from valve_control.cli import command, main

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [p for p in PAGES if "generated" not in p.parts]
# What stands above a block that is not run here: date and machine of its run, or tests that do what it says.
RUN = re.compile(r"run 2\d{3}-\d\d-\d\d, \d+ cores?, Python 3\.\d+")
TESTED = re.compile(r"test/[\w/]+\.py")
STATUS = re.compile(r"status (\d+)")
WITHIN = re.compile(r"numbers within (\d+) %")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
COMMAND = re.compile(r"^(\$ |ros2 |make |colcon |valve-control |rosdep |pip |python |\.venv/bin/)", re.M)
LANGUAGES = ("console", "bash", "python")
HERE = ("valve-control ", "python ")  # what needs neither ROS nor a long time


class Block(NamedTuple):
    line: int
    language: str
    marker: str  # the comment above it
    text: str

    @property
    def commands(self):
        """What is typed: the lines behind $, all lines of a script, or a Python program."""
        if self.language == "python":
            return [f"python -c {shlex.quote(self.text)}"]
        lines = self.text.splitlines()
        return [line[2:] for line in lines if line.startswith("$ ")] if self.language == "console" else lines


def blocks(path):
    """Fenced blocks of a page that hold commands."""
    lines = path.read_text(encoding="utf-8").splitlines()
    at = 0
    while at < len(lines):
        opening = re.match(r"\s*```(.*)$", lines[at])
        if not opening:
            at += 1
            continue
        end = next(k for k in range(at + 1, len(lines)) if lines[k].strip() == "```")
        above = re.fullmatch(r"<!-- (.*) -->", lines[at - 1].strip()) if at else None
        text = textwrap.dedent("\n".join(lines[at + 1 : end]))
        block = Block(at + 1, opening[1], above[1] if above else "", text)
        if block.language in LANGUAGES or (block.language == "" and COMMAND.search(text)):
            yield block
        at = end + 1


def is_run(block):
    return not (RUN.search(block.marker) or TESTED.search(block.marker))


def runnable(path):
    return [block for block in blocks(path) if is_run(block)]


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_each_command_block_is_run_or_says_where_it_was(path):
    for block in blocks(path):
        where = f"{path.name}:{block.line}"
        assert block.language in LANGUAGES, f"{where}: commands in a block without a language"
        assert block.commands, f"{where}: a console block without a line that begins with $"
        for name in TESTED.findall(block.marker):
            assert (ROOT / name).exists(), f"{where}: there is no {name}"
        if is_run(block):
            for line in block.commands:
                assert line.startswith(HERE), f"{where}: neither run by this test nor marked: {line}"


def test_the_readme_leads_to_pages_that_exist_and_is_short():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = text.splitlines()
    assert len(lines) <= 150 and any(line.startswith("```") for line in lines[:25])
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (ROOT / target).exists(), target


def execute(line, capfd):
    """Exit status and output of one command, in this process if it is ``valve-control``."""
    program, *arguments = shlex.split(line, comments=True)
    if program == "valve-control":
        try:
            status = main(arguments)
        except SystemExit as ended:  # argparse
            status = ended.code
        return status, "".join(capfd.readouterr())
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=400, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def run_blocks(path, found, capfd, outputs=False):
    """Run ``found`` and check each exit status; with ``outputs`` also that what is shown is printed.

    The working folder stands for the folder of the repository.
    """
    for name in ("config", "docs"):
        Path(name).symlink_to(ROOT / name)
    for block in found:
        where = f"{path.name}:{block.line}"
        printed = ""
        expected = int(status[1]) if (status := STATUS.search(block.marker)) else 0
        for number, line in enumerate(block.commands, 1):
            assert line.startswith(HERE), f"{where}: not run by this test: {line}"
            status, said = execute(line, capfd)
            printed += said
            assert status == (expected if number == len(block.commands) else 0), f"{where}: {line}\n{said}"
        if outputs and block.language == "console":
            check_outputs(where, block, [line.strip() for line in printed.splitlines()])


def check_outputs(where, block, printed):
    """Whether what a block shows was printed, its words exactly.

    Processors round sines and matrix products differently in the last bit, so a number may differ by one
    unit of the last digit shown, or by what the block's marker allows (``numbers within 30 %``, for runs that
    are not stable). … stands for what was left out, a study's folder has a hash.
    """
    share = float(allowed[1]) / 100.0 if (allowed := WITHIN.search(block.marker)) else 0.0
    for line in block.text.splitlines():
        shown, cut, _ = line.strip().partition("…")
        if not shown or shown.startswith("$ ") or "out/study-" in shown:
            continue
        assert any(agrees(shown, real, share, bool(cut)) for real in printed), f"{where}: {line}"


def agrees(shown, real, share, cut):
    """Whether ``real``, or its beginning, has the words of ``shown`` and its numbers within ``share``."""
    pattern = re.escape(" ".join(NUMBER.sub("\0", shown).split())).replace("\0", f"({NUMBER.pattern})")
    match = (re.match if cut else re.fullmatch)(pattern, " ".join(real.split()))
    return match is not None and all(
        abs(float(a) - float(b)) <= max(share * abs(float(a)), 1.01 * last_digit(a))
        for a, b in zip(NUMBER.findall(shown), match.groups(), strict=True)
    )


def last_digit(number):
    """Worth of the last digit of a printed number."""
    return 10.0 ** Decimal(number).as_tuple().exponent


def long(block):
    return block.marker.startswith("campaign")


RUNNABLE = [path for path in PAGES if runnable(path)]
LONG = [path for path in RUNNABLE if any(long(block) for block in runnable(path))]


@pytest.mark.parametrize("path", RUNNABLE, ids=lambda p: str(p.relative_to(ROOT)))
def test_quick_blocks_run(path, tmp_path, monkeypatch, capfd):
    """What they print too, unless they may need what the long ones of their page make."""
    monkeypatch.chdir(tmp_path)
    run_blocks(path, [b for b in runnable(path) if not long(b)], capfd, outputs=path not in LONG)


@pytest.mark.campaign
@pytest.mark.parametrize("path", LONG, ids=lambda p: str(p.relative_to(ROOT)))
def test_all_blocks_run_and_print_what_is_shown(path, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    run_blocks(path, runnable(path), capfd, outputs=True)


@pytest.mark.campaign
def test_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("sphinx", reason="make docs installs it")
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", ROOT / "docs", tmp_path],
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "index.html").exists()
    loaded = re.compile(
        r"""<(?:script|img|link|iframe|source)\b[^>]*?(?:src|href)=["'](?:https?:)?//[^"']*"""
    )
    for page in tmp_path.rglob("*.html"):
        assert not loaded.findall(page.read_text(encoding="utf-8")), f"{page.name} loads from the network"
    assert "Search.setIndex" in (tmp_path / "searchindex.js").read_text(encoding="utf-8")


# The pages that are generated


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_reference_lists_every_parameter(generate):
    sections = re.split(r"^## ", generate.parameters(), flags=re.M)[1:]
    assert [section.split("\n")[0] for section in sections] == [f"`{node}`" for node in ROS_NODES]
    for section, table in zip(sections, ROS_NODES.values(), strict=True):
        for p in table:
            assert f"| `{p.name}` |" in section, p.name


def test_reference_lists_every_topic_and_service(generate):
    text = generate.topics()
    found = set(generate.entities())
    assert {e.name for e in found} == set(generate.MEANINGS)
    for e in found:
        assert f"| {e.kind} | `{e.name}` | {e.type_name} |" in text
    controller = {(e.kind, e.name) for e in found if e.node == "controller"}
    assert controller >= {
        ("takes", "spool_command"),
        ("takes", "spool_position"),
        ("publishes", "valve_voltage"),
        ("publishes", "~/state"),
        ("serves", "~/load_parameters"),
    }


def test_reference_has_every_command_and_every_room(generate):
    text = generate.command_line()
    for name in command.Commands().parsers:
        assert f"## `valve-control {name}`" in text
    assert {"api/laws", "api/nodes", "api/simulation", "api/index"} <= set(generate.api())
    assert "automodule:: valve_control.control.laws.oarc" in generate.api()["api/laws"]


# Help
