# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import io
import json

import matplotlib.figure
import pytest

from research.theorems import adaptive, bench, figures, robust, sampling, tables
from research.theorems.__main__ import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--valves", "0"], "--valves must be at least 1"),
        (["--processes", "10000"], "--processes is 10000; it must lie between 1 and"),
        (["--seed", "-1"], "--seed must not be negative"),
        (["--errata-figures", "no/such/folder"], "there is no such folder"),
        (["--json", "no/such/folder/a.json"], "there is no folder"),
        (["--figure", "a.txt"], "--figure a.txt must end in .png or .svg"),
        (["--json", "-", "--figure", "-"], "only --json takes - for standard output"),
        (["--figure", "a"], "--figure a must end in .png or .svg"),
        (["--json", "-", "--figure", "no/such/folder/a.svg"], "there is no folder"),
    ],
)
def test_bad_arguments_are_refused_in_one_sentence(capsys, monkeypatch, arguments, message):
    monkeypatch.setattr(robust, "experiment", lambda *_, **__: pytest.fail("the experiment began"))
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


FEW = ("--loop-valves", "4", "--learning-valves", "1", "--processes", "1")


@pytest.fixture
def short(monkeypatch):
    """The experiments on the theorems over in a second."""
    monkeypatch.setattr(
        robust.experiment, "__defaults__", (2000, 1, ("arc",), (1e-3, 5e-4, 2e-4), 0.05, 1, None)
    )
    motions = ("rest", "three sines")
    defaults = (40, 1, ("arc",), motions, (1e-3, 1e-4), 3.0, 1, None)
    monkeypatch.setattr(adaptive.experiment, "__defaults__", defaults)


@pytest.mark.campaign
def test_command_writes_table_json_and_figure(tmp_path, capsys, short):
    target, figure = tmp_path / "a.json", tmp_path / "a.svg"
    arguments = ["--valves", "6", "--adaptive-valves", "2", *FEW]
    assert main([*arguments, "--json", str(target), "--figure", str(figure)]) == 0
    out = capsys.readouterr().out
    assert "ARC, true velocity" in out and "three sines" in out
    result = json.loads(target.read_text())
    assert [c["period"] for c in result["bound"]["cells"]] == [1e-3, 5e-4, 2e-4]
    assert result["bound"]["valves"] == 6 and result["error"]["valves"] == 2
    assert figure.stat().st_size > 10_000


def test_results_are_written_before_the_figure_is_drawn(tmp_path, capsys, monkeypatch, short):
    def full(*_):
        raise OSError(28, "No space left on device", "a.png")

    monkeypatch.setattr(figures, "draw_theorems", full)
    target = tmp_path / "a.json"
    arguments = ["--valves", "2", "--adaptive-valves", "1", *FEW, "--json", str(target)]
    assert main([*arguments, "--figure", str(tmp_path / "a.png")]) != 0
    assert "No space left" in capsys.readouterr().err
    assert json.loads(target.read_text())["bound"]["valves"] == 2


def test_errata_figures_that_cannot_be_written_are_refused_before_the_study(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(robust, "experiment", lambda *_, **__: pytest.fail("the experiment began"))
    (tmp_path / "sample_period.svg").mkdir()
    assert main(["--errata-figures", str(tmp_path)]) == 2
    assert "it is a folder" in capsys.readouterr().err


def test_figures_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    limits = sampling.sample_period_limit([1.44e6], [1e-3], duration=0.5)
    old = tmp_path / "a.PNG"
    old.write_text("old")

    def half(figure, target, **_):
        if isinstance(target, io.BytesIO):
            target.write(b"half")
        else:
            target.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(matplotlib.figure.Figure, "savefig", half)
        with pytest.raises(OSError, match="No space"):
            figures.draw_sample_period([old], limits)
    assert old.read_text() == "old"
    figures.draw_sample_period([old], limits)
    assert old.read_bytes().startswith(b"\x89PNG")


def test_sample_period_table_and_figure(tmp_path):
    limits = sampling.sample_period_limit([1.0, 1.44e6], [2e-4, 1e-3], duration=0.5)
    figures.draw_sample_period([tmp_path / "a.png", tmp_path / "a.svg"], limits)
    assert all((tmp_path / name).stat().st_size > 5_000 for name in ("a.png", "a.svg"))
    data = tables.sampling_data(limits)
    assert [line["z2_weight"] for line in data["lines"]] == [1.0, 1.44e6]
    assert "nan" not in "\n".join(tables.sampling_lines(limits))


def test_work_counts_its_progress():
    seen = []
    assert bench.work(abs, [-1, 2, -3], 1, lambda done, total: seen.append((done, total))) == [1, 2, 3]
    assert seen == [(1, 3), (2, 3), (3, 3)]
